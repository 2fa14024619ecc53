"""The page about several GPUs: its script gives the same losses with one and with two processes."""

import ast
import subprocess
import sys

import pytest
from test_snippets import DOCS, blocks_of, torchrun  # noqa: F401, a fixture

pytestmark = pytest.mark.slow
PAGE = DOCS / "how_to" / "train_on_several_gpus.md"
CHECKS = """
def check_used_once(used, rows):
    every = [torch.empty_like(used) for _ in range(world)]
    dist.all_gather(every, used)
    assert torch.equal(torch.cat(every).sort(dim=0).values, rows.sort(dim=0).values)


stream = StratifiedOT(clusters).stream(mine, batch_size=JOINT // world, generator=seeded(rank))
check_used_once(torch.cat([next(stream).x1 for _ in range(len(x1) // JOINT)]), x1)

part = JOINT // world
pairs = next(gathered([(mine.x1[:part], mine.c[:part])], ConditionalOT()))
check_used_once(pairs.x1, x1[:JOINT])
x0, rows = torch.randn((JOINT, 2), generator=seeded(0)), torch.arange(JOINT)
order = rows.reshape(part, world).T.reshape(-1)
assert torch.equal(pairs.x1, x1[:JOINT][order][pairs.target_index])
assert torch.equal(pairs.x0, x0[pairs.source_index])
"""


def losses_of_two(script):
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node"]
    done = subprocess.run([*command, "2", str(script)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ast.literal_eval(done.stdout)


@pytest.mark.usefixtures("torchrun")
def test_two_ranks_train_as_one_does(tmp_path, capsys):
    code = "".join(code for _, code in blocks_of(PAGE)[:5])
    assert "destroy_process_group" in code
    code = code.replace("\nif rank == 0:", f"{CHECKS}\nif rank == 0:")
    script = tmp_path / "train.py"
    script.write_text(code)
    exec(compile(code, "train.py", "exec"), {"__name__": "__main__"})  # one rank
    one, two = ast.literal_eval(capsys.readouterr().out), losses_of_two(script)
    assert two["joint"] == pytest.approx(one["joint"], rel=1e-4)
    assert two["local"] != pytest.approx(one["local"], rel=1e-4)
    assert one["joint"][-1] < one["joint"][0]
