import signal
import subprocess
import sys
import time

import pytest
import typer
from typer.testing import CliRunner

from cotlearn import cli


def test_the_module_is_the_command_and_starts_without_torch():
    code = "import sys, cotlearn.cli; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    command = [sys.executable, "-m", "cotlearn", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert all(name in done.stdout for name in ("lab", "run", "doctor", "bench"))


@pytest.mark.parametrize("group", ["demos", "train", "bench"])
def test_the_help_of_a_group_names_the_tasks(group):
    assert "push-t" in CliRunner().invoke(cli.app, [group, "--help"]).output


@pytest.mark.parametrize(("package", "extra"), [("mujoco", "course"), ("ray", "peers")])
def test_a_missing_package(package, extra, capsys):
    with pytest.raises(typer.Exit) as stopped, cli.terminal.reported():
        raise ModuleNotFoundError(name=package)
    assert stopped.value.exit_code == 2
    said = f"{package} is not installed; install it with: pip install '.[{extra}]'"
    assert said in capsys.readouterr().err


class Interrupted:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)


def drop_one_and_go_on():
    Interrupted()
    time.sleep(60)


def test_ctrl_c_in_a_destructor_still_ends_a_command():
    """Python prints what a destructor raises and goes on: a `bench` ran to its end."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    begun = time.monotonic()
    try:
        with pytest.raises(typer.Exit) as stopped, cli.terminal.reported():
            drop_one_and_go_on()
    finally:
        signal.signal(signal.SIGINT, before)
    assert stopped.value.exit_code == 130
    assert time.monotonic() - begun < 30


@pytest.mark.parametrize(("task", "package"), [("push-t", "pymunk"), ("arm-ring", "mujoco")])
@pytest.mark.parametrize("command", ["train", "bench"])
def test_a_simulator_is_looked_for_before_the_training(
    command, task, package, monkeypatch, tmp_path
):
    """On a base installation a policy was trained for three minutes before this was said."""

    def trains(*_, **__):
        raise AssertionError("the training began")

    there = cli.policies.find_spec
    monkeypatch.setattr(cli.policies, "find_spec", lambda n: None if n == package else there(n))
    monkeypatch.setattr("cotlearn.policies.training.train", trains)
    monkeypatch.setattr("cotlearn.policies.bench.train", trains)
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(cli.app, [command, task])
    assert result.exit_code == 2
    assert f"{package} is not installed; install it with: pip install '.[course]'" in result.output
    assert list(tmp_path.iterdir()) == []


def test_a_training_without_rollouts_needs_no_simulator(monkeypatch, tmp_path):
    monkeypatch.setattr(cli.policies, "find_spec", lambda n: None)
    words = ["train", "push-t", "--rollouts", "0", "--steps", "1", "--episodes", "3"]
    out = tmp_path / "p.safetensors"
    result = CliRunner().invoke(cli.app, [*words, "--coupling", "independent", "--out", str(out)])
    assert (result.exit_code, out.exists()) == (0, True), result.output


def test_a_command_gets_the_shared_options_that_were_given():
    app, seen = typer.Typer(), []

    @app.command()
    @cli.policies.with_options
    def command(name: cli.policies.Name, options: dict, seed: int = 0) -> None:
        seen.append((name, options, seed))

    CliRunner().invoke(app, ["push-t", "--steps", "7", "--frame", "world", "--seed", "3"])
    CliRunner().invoke(app, ["push-t"])
    assert seen == [("push-t", {"steps": 7, "frame": "world"}, 3), ("push-t", {}, 0)]
    setting, file = cli.policies.setting("push-t", {"steps": 7}, None)
    assert setting.options.steps == 7
    assert file.name == "push_t_demos.npz"


def test_the_help_of_train_tells_defaults_and_no_long_range():
    text = CliRunner().invoke(cli.app, ["train", "--help"]).output
    assert " ".join(text.replace("│", " ").split()).count("default: the task's") == 7
    assert "2233720" not in text
    refused = CliRunner().invoke(cli.app, ["train", "push-t", "--seed", str(2**63)])
    assert refused.exit_code == 2
    assert "Invalid value for '--seed'" in refused.output
