"""The page with every score of the robots says what the stored tables say."""

import json
import re
from pathlib import Path

import pytest

from cotlearn.plots import label_of
from cotlearn.policies.comparison.stored import stored_comparison

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/reference/one_step_on_robots.md"
STEMS = [path.stem for path in (ROOT / "data/results").glob("own_settings_*.json")]


def rows_of(section):
    """The rows below a heading that tell a number first, each with the task it stands under."""
    part = PAGE.read_text("utf-8").split(f"## {section}\n")[1].split("\n## ")[0]
    task, found = "", []
    for line in part.splitlines():
        label, *told = [cell.strip() for cell in line.split("|")[1:-1]] or ["", "", ""]
        task = task if any(told) else label.strip("*")
        if told[0].isdigit():
            found.append([task, label, *told])
    return part, found


def test_every_row_is_that_of_its_table():
    parts = re.split(r"\n## ", PAGE.read_text("utf-8"))
    parts = [part for part in parts if "`data/results/" in part and "| method |" in part]
    assert len(parts) == 5
    for part in parts:
        expected = []
        for name in re.findall(r"(\w+)\.json", part):
            table = stored_comparison(name)
            for method in table.methods:
                row = table.at(method, 1) or table.at(method, 2)
                cool = table.at(method, 1, cooled=True) or row
                success = row.get("success", row.get("success_95"))
                both = (f"{each['energy_score']:.2f}" for each in (row, cool))
                energy = "{} ({})" if cool["energy_score"] != row["energy_score"] else "{}"
                scores = f"{success:.3f}".removeprefix("0"), energy.format(*both)
                expected.append((label_of(method), str(len(row["seeds"])), *scores))
        listed = []
        for line in part.splitlines():
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            label, _, seeds, *found = cells + [""] * 9
            if seeds.isdigit():
                success = next(value for value in found if value).split(" ")[0]
                number = r"\d+\.\d\d( \(\d+\.\d\d\))?"
                energy = next(value for value in found[::-1] if re.fullmatch(number, value))
                listed.append((label, seeds, success, energy))
        assert listed == expected


def test_the_costs_of_a_step_are_those_of_the_file():
    cells = json.loads((ROOT / "data/results/step_costs.json").read_text("utf-8"))["cells"]
    for loss, counted in cells[0]["counted"].items():
        values = (counted, *(cell["measured"][loss] for cell in cells))
        assert f"| {loss} | {' | '.join(f'{v:.2f}' for v in values)} |" in PAGE.read_text("utf-8")


def test_the_table_of_executed_actions_is_that_of_the_files():
    page, listed = rows_of("Executing fewer actions")
    expected = []
    for name in re.findall(r"replanning_\w+\.json", page):
        rows = {}
        for cell in json.loads((ROOT / "data/results" / name).read_text("utf-8"))["cells"]:
            policy, nfe, execute = cell["key"].values()
            method = policy.split("/")[1].removeprefix("push_t_").rpartition("-")
            row = rows.setdefault((method[0] or method[2], nfe), {})
            row.setdefault(execute, []).append(cell["success"])
        for (method, nfe), row in rows.items():
            means = (f"{sum(row[n]) / len(row[n]):.2f}" for n in (12, 8, 4, 2))
            expected.append([label_of(method), str(len(row[8])), str(nfe), *means])
    told = [[*row[1:4], *(one.split(" ")[0] for one in row[4:])] for row in listed]
    assert sorted(told) == sorted(expected)


def test_the_table_of_own_settings_is_that_of_the_files():
    page, listed = rows_of("Own settings")
    expected = []
    for name in re.findall(r"own_settings_\w+(?=\.json)", page):
        for (method, _), row in stored_comparison(name).rows.items():
            chosen = (row[f"{what}_of_seeds"] for what in ("execute", "temperature"))
            success = f"{row.get('success', row.get('success_95')):.3f}".removeprefix("0")
            told = (", ".join(f"{value:g}" for value in each) for each in chosen)
            expected.append([label_of(method), str(row["nfe"]), *told, success])
    assert [[*row[1:5], row[5].split(" ")[0]] for row in listed] == expected


def test_the_table_of_settled_policies_is_that_of_the_files():
    page, listed = rows_of("Settled")
    expected = []
    for name in re.findall(r"settled_([\w.]+)\.json", page):
        text = (ROOT / f"data/results/settled_{name}.json").read_text("utf-8")
        rows = {}
        for cell in sorted(json.loads(text)["cells"], key=lambda cell: cell["key"]["seed"]):
            method, _, sampler = cell["key"].values()
            rows.setdefault((method, sampler), []).append(cell["success"])
        for key, row in stored_comparison(f"own_settings_{name}").rows.items():
            if each := rows.get(key):
                values = round(sum(each) / len(each), 6), *each
                mean, *told = (f"{v:.3f}".removeprefix("0") for v in values)
                expected.append([label_of(key[0]), str(row["nfe"]), mean, ", ".join(told)])
    assert [[*row[1:3], *row[7:9]] for row in listed] == expected


def said(lesson):
    """All that a lesson holds."""
    return next((ROOT / "notebooks").glob(f"{lesson}_*.ipynb")).read_text("utf-8")


def two_digits(value):
    """And a third one between .99 and 1."""
    return f"{value:.3f}".rstrip("0") if 0.99 <= value < 0.9995 else f"{value:.2f}"


def mean(name, method, sampler, score="success"):
    """Of the networks of a settled policy, in words."""
    cells = json.loads((ROOT / f"data/results/settled_{name}.json").read_text("utf-8"))["cells"]
    key = {"method": method, "sampler": sampler}
    each = [cell[score] for cell in cells if key.items() <= cell["key"].items()]
    return f"{round(sum(each) / len(each), 6):.2f}"


def test_the_how_to_shows_the_settled_policies():
    page = (ROOT / "docs/how_to/choose_a_policy.md").read_text("utf-8")
    page = page.split("### From the last plan")[1].split("\n\n")[2]
    names = ("arm_ring_receding", "push_t", "push_t_human", "push_t_pixels")
    for line in page.splitlines()[2:]:
        label, *told = (cell.strip() for cell in line.strip("|").split("|"))
        for cell, name in zip(told, names, strict=True):
            rows = stored_comparison(f"own_settings_{name}").rows
            (key,) = (k for k in rows if label_of(k[0]) == label and rows[k]["nfe"] == 1)
            scores = ("success",) if name.startswith("arm") else ("success", "score")
            expected = [mean(name, *key, score).removeprefix("0") for score in scores]
            assert cell == " (".join(expected) + ")" * (len(scores) - 1)


def test_how_to_and_lesson_show_the_best_training_of_each_row():
    page = (ROOT / "docs/how_to/choose_a_policy.md").read_text("utf-8")
    page = page.split("## What the stored tables say")[1].split("\n\n")[2]
    usual = {  # the trainings of a column, and the usual one
        "arm": ("arm_ring_receding(.*)_goal", "_rate_0.003"),
        "planned": ("push_t(|_[0-9].*|_rate.*)", ""),
        "people": ("push_t_human(.*)", ""),
        "pixels": ("push_t_pixels(|_rate.*|_12000.*)", "_12000"),
    }

    def gain(row, ours):  # on exploration starts, by the networks that both have
        both = set(row["seeds"]) & set(ours["seeds"])
        each = [r["explored_of_seeds"][r["seeds"].index(s)] for r in (row, ours) for s in both]
        return (sum(each[: len(both)]) - sum(each[len(both) :])) / len(both)

    lesson = said("13").replace("\\", "")
    lesson = set(re.findall(r'\("(\w+)", "(\w+)", (\d)\): "([\w.]+)"', lesson))
    starred = set()
    for line in page.splitlines()[2:]:
        label, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        for cell, (task, (pattern, ours)) in zip(cells, usual.items(), strict=True):
            expected = []
            for nfe in (1, 2, 16):
                found = {}
                for stem in STEMS:
                    if name := re.fullmatch(f"own_settings_{pattern}", stem):
                        rows = stored_comparison(stem).rows.values()
                        rows = [
                            r for r in rows if (label_of(r["method"]), r["nfe"]) == (label, nfe)
                        ]
                        found |= {name[1]: rows[0]} if rows else {}
                if ours not in found:
                    continue
                best = max(found, key=lambda name: gain(found[name], found[ours]))
                best = best if gain(found[best], found[ours]) > 0.0299 else ours
                won = found[best].get("success", found[best].get("success_95"))
                expected.append(two_digits(won).replace("0.", ".") + "*" * (best != ours))
                if best != ours and nfe < 16:
                    stem = pattern.partition("(")[0] + best + pattern.rpartition(")")[2]
                    starred.add((task, found[best]["method"], str(nfe), stem))
            assert cell.partition("<")[0] == ", ".join(expected)
    assert starred == lesson


def test_lessons_quote_the_settled_policies():
    """Where no cell of a lesson has room for the claim."""
    arm, one = "arm_ring_receding", "ddim-1-trailing"
    free, paired = "independent", "residual"
    own = stored_comparison("own_settings_arm_ring_receding_rate_0.003_goal").at
    eight = stored_comparison("arm_ring_receding_data").at
    for few, pairs in ((free, paired), ("diffusion", "diffusion_residual")):
        first, second = (eight(pairs, k)["success"] - eight(few, k)["success"] for k in (1, 2))
        assert 0.145 < first < 0.165
        assert 0.025 < second < 0.055
        for nfe in (1, 2):
            assert 0.04 < own(pairs, nfe)["success"] - own(few, nfe)["success"] < 0.06
    both = eight("mean_flow_data", 1), stored_comparison(arm).at("mean_flow", 1)
    both = (row["success"] for row in both)
    assert "has {:.2f}, with the velocity {:.2f}.".format(*both) in said("10")
    pixels = stored_comparison("own_settings_push_t_pixels_12000").at
    at = [f"{pixels(m, 16)['success_95']:.2f}" for m in (paired, free)]
    at += [f"{pixels(m, 16)['success_95']:.2f}" for m in ("diffusion_residual", "diffusion")]
    assert "on clusters most ({0} against {1} and {3})".format(*at) in said("11")
    both = (mean(arm, method, one) for method in ("diffusion_residual", "diffusion"))
    assert "DDIM has {} with them and {} without; elsewhere".format(*both) in said("13")
    for name in ("push_t", "push_t_human", "push_t_pixels", f"{arm}_12000_rate_0.003_goal"):
        pairs, few = (float(mean(name, m, one)) for m in ("diffusion_residual", "diffusion"))
        assert pairs < few + 0.02
    why = json.loads((ROOT / "data/results/last_plan_why.json").read_text("utf-8"))["cells"]
    for guess in ("regression", "another episode's"):
        each = {"independent": [], "diffusion": []}
        for cell in why:
            if cell["key"]["guess"] == guess:
                each[cell["key"]["method"]].append(cell["success"])
        flow, ddim = (f"{sum(both) / len(both):.2f}" for both in each.values())
        assert f"({flow} and {ddim}" in said("08")


@pytest.mark.parametrize(
    ("section", "ending"),
    [
        ("Length of training", r"_\d+$"),
        ("Learning rate", r"_rate_[\d.]+$"),
        ("Frame of the goal", r"(_\d+)?(_rate_[\d.]+)?_goal(_velocity)?$"),
    ],
)
def test_the_tables_of_other_trainings_are_those_of_the_files(section, ending):
    _, listed = rows_of(section)
    stems = [stem for stem in STEMS if re.search(ending, stem)]
    assert stems
    tasks = {
        "own_settings_push_t": "Push-T, planned",
        "own_settings_push_t_pixels": "Push-T from pixels",
        "own_settings_push_t_pixels_12000": "Push-T from pixels, 12,000 steps",
        "own_settings_push_t_human": "Push-T, people",
        "own_settings_arm_ring_receding": "arm, planning again",
    }
    for stem in stems:
        for (method, _), row in stored_comparison(stem).rows.items():
            each = row["success_of_seeds" if "success" in row else "success_95_of_seeds"]
            told = ", ".join(f"{value:.3f}".removeprefix("0") for value in each)
            if "coverage" in row:
                told += f" ({row['coverage']:.2f})".replace("(0", "(")
            task = "" if "goal" in stem else tasks[re.sub(ending, "", stem)]
            start = [task, label_of(method), str(row["nfe"])]
            found = ([cell.replace("*", "") for cell in one] for one in listed)
            assert any(one[:3] == start and told in one[3:] for one in found), (stem, start)


def test_lessons_quote_another_rate():
    pixels = stored_comparison("own_settings_push_t_pixels_12000_rate_0.003").at
    people = stored_comparison("own_settings_push_t_human_rate_0.003").at
    rows = [pixels(m, 1) for m in ("independent", "diffusion", "residual", "diffusion_residual")]
    rows += people("mean_flow_data", 2), people("diffusion", 1)
    rows += people("mean_flow_data_residual", 2), people("diffusion_residual", 1)
    each = [two_digits(row["success_95"]) for row in rows]
    assert "flow {} and DDIM {} at one, on clusters {} and {}: level".format(*each) in said("11")
    assert "{} at two, DDIM {} at one; on residual pairs {} and {},".format(*each[4:]) in said("14")
    world = [stored_comparison(f"own_settings_arm_ring_receding{n}").at for n in ("", "_12000")]
    each = [two_digits(at("minibatch_ot", k)["success"]) for at in world for k in (1, 16)]
    assert "own settings: {} to {}, after twice the steps {} to {})".format(*each) in said("10")
    names = "arm_ring_data_rate_0.003", "arm_ring_data_12000"
    each = [stored_comparison(name).at("independent", 1)["success"] for name in names]
    assert "12,000 steps, flows have {:.2f} or {:.3f}, one way".format(*each) in said("10")


def test_the_page_quotes_other_trainings():
    page, arm = PAGE.read_text("utf-8"), "own_settings_arm_ring_receding_"
    for words, name, method, nfes in (
        ("MeanFlow leads with {}", f"{arm}goal", "mean_flow", [2]),
        ("it rises from .715 to {} at one", f"{arm}rate_0.003", "mean_flow", [1]),
        ("passes both at one: {}, and {} at two", f"{arm}12000", "mean_flow_data", [1, 2]),
        ("with .003 three have {} and {})", f"{arm}rate_0.003", "mean_flow_data", [1, 2]),
        ("has {} at one, and {} at two:", f"{arm}rate_0.003_goal_velocity", "independent", [1, 2]),
        ("pairs, {}, {} and {} at", "arm_avoid_rate_0.001", "adaptive_weights", [1, 2, 16]),
        ("temperature {}, {} and {})", "arm_avoid_rate_0.001", "adaptive_weights", [1, 2, 16]),
        ("path has {}, {} and {} at", "arm_avoid_data_adaptive", "adaptive_weights", [1, 2, 16]),
    ):
        at = stored_comparison(name).at
        rows = (at(method, nfe, cooled="temperature" in words) for nfe in nfes)
        each = (f"{row['success']:.3f}".removeprefix("0").removesuffix("0") for row in rows)
        assert words.format(*each) in page, words


def test_meanflow_with_the_chunk_is_quoted_as_the_files_say():
    def told(name, method, nfe, score="success"):
        row = stored_comparison(name).at(method, nfe)
        return two_digits(row[score] if score in row else row[f"{score}_95"])

    page = PAGE.read_text("utf-8").split("## MeanFlow with the chunk")[1].split("\n## ")[0]
    jump, paired, both = "mean_flow_data", "mean_flow_data_residual", (1, 2)
    people = [told("push_t_human_data", jump, k) for k in both]
    words = "people's demonstrations in {} at one evaluation and {} at two".format(*people)
    assert words.replace("0.", ".") in page
    narrow = [told("arm_avoid_data", m, k) for m in (paired, jump) for k in both]
    assert "with MeanFlow** ({}, without pairs {}), ".format(*narrow[1::2]) in said("10")
    tables = [stored_comparison(f"arm_avoid{name}") for name in ("", "_data")]
    for k in (1, 2, 16):
        rows = [(t.at(m, k), m) for t in tables for m in t.methods]
        assert max((row["success"], m) for row, m in rows if row)[1] == paired
    at = stored_comparison("own_settings_push_t_pixels_12000").at
    each = [told("own_settings_push_t_pixels_12000", jump, k) for k in (1, 2, 16)]
    assert "does not fall: {}, {} and {} at 1, 2 and 16".format(*each) in said("11")
    assert all(at(jump, k)["success_95"] > at(paired, k)["success_95"] for k in (2, 16))
    long, usual = (stored_comparison(f"arm_avoid_data{end}").at for end in ("_12000", ""))
    each = ((usual, jump), (long, jump), (long, paired))
    each = (at(method, 2)["success_of_seeds"][0] for at, method in each)
    words = "from {:.2f} to {:.2f}, on residual pairs it stays at {:.2f}".format(*each)
    assert words in said("10")


def test_lesson_14_quotes_the_lengths_of_training():
    told = said("14")
    short, long = (stored_comparison(f"own_settings_push_t_human{n}").at for n in ("", "_16000"))

    def quoted(at, method, score="success_95"):
        return [f"{at(method, nfe)[score]:.2f}" for nfe in (1, 2)]

    for nfe in (1, 2):
        own = long("residual", nfe)["success_95"], short("independent", nfe)["success_95"]
        assert abs(own[0] - own[1]) < 0.04
    pairs = zip(quoted(short, "reflow"), quoted(short, "mean_flow_data"), strict=True)
    words = (f"{' and '.join(both)} at {k}" for both, k in zip(pairs, ("one", "two"), strict=True))
    settled = mean("push_t_human", "independent", "euler-1")
    words = (
        f"with {', '.join(words)}; from the last plan, at one, independent pairs have {settled} ("
    )
    assert f"the chunk lead from noise: after 8,000 steps {words}" in told
    eight = {name: stored_comparison(f"push_t_human{name}") for name in ("", "_data")}
    for nfe in (1, 2):
        every = [(t.at(m, nfe), m) for t in eight.values() for m in t.methods]
        (second, _), (most, method) = sorted((r["success_95"], m) for r, m in every if r)[-2:]
        assert method == "mean_flow_data"
        assert most > second + 0.05
    data = eight["_data"].at
    assert "in {} at one and in {} at two.".format(*quoted(data, "mean_flow_data")) in told
    assert "It covers {} and {}, ".format(*quoted(data, "mean_flow_data", "coverage")) in told
    words = f"succeed in {quoted(data, 'independent')[0]}, with the velocity in "
    assert f"{words}{quoted(eight[''].at, 'independent')[0]}." in told


def test_other_trainings_of_whole_paths_are_those_of_the_files():
    _, rows = rows_of("Whole paths")
    stems = (path.stem for path in (ROOT / "data/results").glob("arm_*.json"))
    stems = (re.fullmatch(r"arm_(avoid|ring)(_data)?(_\d{4,}|_rate.*)?", stem) for stem in stems)
    tables = {stem[0]: stored_comparison(stem[0]) for stem in stems if stem}
    endings = "_3000", "", "_12000", "_rate_0.001", "_rate_0.003"
    ways, told = {}, set()
    for task, label, nfe, target, *cells in rows:
        name = {"between two rows": "arm_avoid", "past a pillar": "arm_ring"}[task]
        for cell, ending in zip(cells, endings, strict=True):
            stem = name + "_data" * (target == "path") + ending
            table = tables.get(stem)
            methods = [m for m in table.methods if label_of(m) == label] if table else ()
            row = next((table.at(method, int(nfe)) for method in methods), None)
            each = row["success_of_seeds"] if row else ()
            assert cell == ", ".join(f"{won:.3f}".removeprefix("0") for won in each)
            told |= {stem} if row else set()
            if row and stem.startswith("arm_avoid") and ending == "_12000":
                ways.setdefault(row["method"], []).append(row["mode_entropy"])
    assert told == set(tables)
    memorise = "independent", "adaptive_weights", "mean_flow", "mean_flow_data"
    assert max(max(ways[method][:2]) for method in memorise) < 0.05
    assert min(min(ways[f"{method}_residual"]) for method in memorise[1:]) > 1.6


def test_the_how_to_quotes_whole_paths():
    told = (ROOT / "docs/how_to/choose_a_policy.md").read_text("utf-8")
    told = told.split("### Whole paths")[1].split("\n## ")[0]
    ring = stored_comparison("arm_ring_data").at
    tables = [stored_comparison(f"arm_avoid{name}") for name in ("", "_data")]
    each = [tables[1].at("mean_flow_data", nfe)["success"] for nfe in (1, 2, 16)]
    assert "MeanFlow has {:.2f}, {:.2f} and {:.2f} at".format(*each).replace("0.", ".") in told
    methods = "mean_flow_data", "minibatch_ot", "residual", "independent"
    each = (two_digits(ring(method, 1)["success"]) for method in methods)
    words = (
        "MeanFlow has {} at one evaluation, naive OT {}, residual pairs {}, independent pairs {}."
    )
    assert words.format(*each).replace("0.", ".") in told
    ways = {"adaptive weights": "adaptive_weights", "flow": "residual", "": "minibatch_ot"}
    ways |= {"MeanFlow": "mean_flow"} | dict.fromkeys(("DDIM", "DDPM"), "diffusion")
    rows = [line.split("|")[1:-1] for line in told.splitlines() if re.match(r"\| \d", line)]
    assert len(rows) == 4
    for nfe, *cells in rows:
        for column, cell in enumerate(each.strip() for each in cells):
            table = tables[column > 1]
            for way, value in re.findall(r"([A-Za-z ]*?) ?(\.\d+)", cell.replace(", ", ",")):
                paired = "_residual" * (0 < column < 3 and way != "flow")
                method = ways[way] + "_data" * (column > 1 and way == "MeanFlow") + paired
                method = "independent" if way == "flow" and not column else method
                row = table.at(method, int(nfe)) or table.rows[method, "ddpm-100"]
                assert two_digits(row["success"]).removeprefix("0") == value
