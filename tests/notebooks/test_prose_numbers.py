"""A decimal or a percentage of the prose stands in an output or in the code of its notebook."""

import re

#: Not a number of prose: what is code, a formula, the target of a link, or the number of a paper.
OTHER = re.compile(r"```.*?```|`[^`]*`|\$\$.*?\$\$|\$[^$]*\$|\]\([^)]*\)|\d{4}\.\d{4,5}", re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])(\d*\.\d+|\d+(?:\.\d+)?\s?%)(?![\w.]*\d)")
PRINTED = re.compile(r"\d*\.?\d+")
TAG = re.compile(r"<[^>]+>")
#: What no cell computes: definitions, and what a paper that is cited beside it says.
GIVEN = {
    "00_start_here": {"1.2": "how the petals are made"},
    "05_model_aligned_coupling": {
        "25.6": "64 times .4",
        "12.5": "an eighth, in percent",
        ".28": "the weight of a mode in the authors' example",
    },
    "09_arm_the_task": {"2.5": "centimetres: when the task counts as done"},
    "11_from_state_to_pixels": {
        "12.8": "512 / 40",
        "95 %": "the intervals of every table",
        "0.95": "the coverage of a success",
    },
    "12_your_data": {"2.8": "a quantile of the normal distribution, after Bonferroni"},
    "14_human_demonstrations": {
        "2.5": "a tail of a 95 % interval",
        "97.5": "the other one",
        ".82": "scores in other papers",
    },
    "01_source_guided_flow_matching": {".124": "the paper", ".067": "the paper"},
    "02_variational_rectified_flow_matching": {"1.44": "bits in a nat", "0.69": "ln 2"},
    "04_streams_by_gaussian_processes": {"0.42": "1 - 0.58"},
    "10_the_noise_behind_a_demonstration": {"0.25": "how the petals are made"},
    "06_optimal_fields_in_detail": {"0.001": "what the check wants"},
}


def shown(cells):
    """The numbers in the code and in the text of the outputs, as printed."""
    texts = [cell.source for cell in cells if cell.cell_type == "code"]
    for output in (o for cell in cells for o in cell.get("outputs", [])):
        texts.append(output.get("text", ""))
        data = output.get("data", {}).items()
        texts += [TAG.sub(" ", text) for kind, text in data if kind.startswith("text/")]
    return {float(number) for number in PRINTED.findall("\n".join(texts))}


def stands_in(number, there):
    """Whether a number of prose is one of these, rounded; a percentage may be a share."""
    digits = number.removesuffix("%").strip()
    off = 0.5 * 10.0 ** -len(digits.partition(".")[2]) + 1e-9
    scales = (1, 100) if number.endswith("%") else (1,)
    return any(abs(scale * one - float(digits)) <= off for one in there for scale in scales)


def unknown(cells, given=()):
    """The numbers of the prose that no output has, each with the words before it."""
    there, found = shown(cells), []
    for cell in (cell for cell in cells if cell.cell_type == "markdown"):
        prose = OTHER.sub(" ", cell.source)
        for match in NUMBER.finditer(prose):
            if match[1] not in given and not stands_in(match[1], there):
                found.append(prose[max(0, match.start() - 40) : match.end()])
    return found


def test_every_number_of_the_prose_is_shown(cells, path):
    assert unknown(cells, GIVEN.get(path.stem, ())) == []


def test_a_number_that_is_not_shown_is_found(cells, path):
    cells = [
        *cells,
        type(cells[0])(cell_type="markdown", source="It wins by 7.4321 and 98.76543 %."),
    ]
    assert len(unknown(cells, GIVEN.get(path.stem, ()))) >= 2
