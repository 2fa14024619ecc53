"""What docs/speed.md says is what the stored benchmarks say."""

import statistics
from pathlib import Path

from cotlearn.results import read_table

ROOT = Path(__file__).resolve().parents[2]
TEXT = " ".join((ROOT / "docs" / "speed.md").read_text(encoding="utf-8").split())


def test_exact_pairing():
    table = read_table("assignment")
    ms = table.filter(like="milliseconds_")
    ours = ms.pop("milliseconds_cotlearn")
    ratio = ms["milliseconds_torchcfm"] / ours
    times = statistics.geometric_mean(ratio)
    assert f"{times:.1f} times as fast in the geometric mean of {len(table)}" in TEXT
    assert table["relative_cost_difference"].max() < 1e-6
    behind = ours - ms.min(axis=1)
    assert (behind <= 0).sum() == 58
    assert "In 58 of the 60 cells no other method was faster" in TEXT
    assert set(table.loc[behind > 0, "rows"]) == {128}
    worst = behind.idxmax()
    others, own = ms.min(axis=1)[worst], ours[worst]
    assert f"at worst {others:.1f} ms where we need {own:.1f}" in TEXT
    said_at = {
        128: "2.1 times at 128 rows",
        256: "4.0 at 256",
        512: "7.9 at 512",
        2048: "10.6 at 2,048",
    }
    for rows, said in said_at.items():
        times = statistics.geometric_mean(ratio[table["rows"] == rows])
        assert said in TEXT
        assert abs(times - float(said.split()[0])) < 0.06


def test_training_overhead():
    table = read_table("training_overhead").set_index("coupling")
    ratios = table.loc["conditional_ot", "ratio_to_independent"]
    assert f"takes {ratios.min():.2f} to {ratios.max():.2f} times as long" in TEXT
    assert ratios.max() < 1.3


def test_the_whole_data_set():
    table = read_table("whole_data")
    strata = table["coupling"] == "stratified"
    assert round(table.loc[strata, "pairs_per_second"].item(), -3) == 50_000
    assert "50,000 pairs a second" in TEXT
    assert table["peak_mb"].max() < 1000
    clustered = table[~strata & table["clusters"].notna()]
    assert clustered["microseconds_per_pair"].max() < 100
