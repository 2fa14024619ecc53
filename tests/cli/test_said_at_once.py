"""A wrong name is refused before torch loads; a long command says at once what it does."""

import subprocess
import sys

import pytest

CODE = """
import sys
from cotlearn import cli
try:
    cli.app({words!r})
except SystemExit as ended:
    print(ended.code, "torch" in sys.modules)
"""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["check", "99"], "there is no notebook '99'"),
        (["check", "03", "99"], "there is no notebook '99'"),
        (["run", "77"], "there is no notebook '77'"),
        (["report", "nope.npz"], "no such file: nope.npz"),
        (["train", "push-t", "--data", "nope.npz"], "no such file: nope.npz"),
        (["bench", "push-t", "--data", "nope.npz"], "no such file: nope.npz"),
        (["challenge", "nope.py"], "no such file: nope.py"),
        (["grade", "nope"], "folder must be a folder of notebooks, got nope"),
        (["watch", "push-t", "--policy", "nope.st"], "no such file: nope.st"),
    ],
)
def test_a_wrong_name_is_refused_before_torch_loads(words, said, tmp_path):
    code = [sys.executable, "-c", CODE.format(words=words)]
    done = subprocess.run(code, capture_output=True, text=True, check=True, cwd=tmp_path)
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == "2 False\n"
