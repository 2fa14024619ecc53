"""What docs/speed.md says is what the stored benchmarks say."""

import json
import statistics
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TEXT = " ".join((ROOT / "docs" / "speed.md").read_text(encoding="utf-8").split())


def stored(name):
    return json.loads((ROOT / "data" / "results" / f"{name}.json").read_text(encoding="utf-8"))


def test_exact_pairing():
    document = stored("assignment")
    times = document["summary"]["times_faster_than_torchcfm"]
    assert f"{times:.1f} times as fast in the geometric mean of {len(document['cells'])}" in TEXT
    assert document["summary"]["largest_relative_cost_difference"] < 1e-6
    slower = 0
    for cell in document["cells"]:
        ms = dict(cell["milliseconds"])
        slower += ms.pop("cotlearn") > min(ms.values())
    assert slower == 0
    assert "in none of the 60 cells was another method faster" in TEXT
    for rows, said in ((128, "2.3 times at 128 rows"), (512, "5.8 at 512"), (2048, "6.5 at 2,048")):
        ms = [c["milliseconds"] for c in document["cells"] if c["key"]["rows"] == rows]
        ratio = statistics.geometric_mean(m["torchcfm"] / m["cotlearn"] for m in ms)
        assert said in TEXT
        assert abs(ratio - float(said.split()[0])) < 0.06


def test_training_overhead():
    cells = stored("training_overhead")["cells"]
    ratios = [cell["ratio_to_independent"]["conditional_ot"] for cell in cells]
    assert f"takes {min(ratios):.2f} to {max(ratios):.2f} times as long" in TEXT
    assert max(ratios) < 1.3


def test_the_whole_data_set():
    cells = stored("whole_data")["cells"]
    [strata] = [c for c in cells if c["key"]["coupling"] == "stratified"]
    assert round(strata["pairs_per_second"], -3) == 50_000
    assert "50,000 pairs a second" in TEXT
    assert max(c["peak_mb"] for c in cells) < 1000
    clustered = [c for c in cells if c["key"]["coupling"] != "stratified" and c["key"]["clusters"]]
    assert max(c["microseconds_per_pair"] for c in clustered) < 100
