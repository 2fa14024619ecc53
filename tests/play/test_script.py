"""The modules become one script, and numbers survive the way to the browser."""

import base64
import gzip
import json

import numpy as np
import pytest
import torch

from cotlearn.mixtures import moving_modes
from cotlearn.play import content, packing, script
from cotlearn.plots.style import LOOKS


def test_each_module_comes_once_and_after_those_that_it_imports(tmp_path, monkeypatch):
    (tmp_path / "a.js").write_text('import { x, y as z } from "./b.js";\nexport const w = x + z;\n')
    (tmp_path / "b.js").write_text("export const x = 1;\nexport function y() {}\n")
    monkeypatch.setattr(script, "FOLDER", tmp_path)
    text = script.joined("a", "b")
    assert text.index("const b_js") < text.index("const a_js")
    assert text.count("const x = 1;") == 1
    assert "const { x, y: z } = b_js;" in text
    assert "export" not in text


def test_another_form_of_import_is_named(tmp_path, monkeypatch):
    (tmp_path / "a.js").write_text('import * as b from "./b.js";\n')
    monkeypatch.setattr(script, "FOLDER", tmp_path)
    with pytest.raises(ValueError, match=r"a\.js must not have this form: import \*"):
        script.joined("a")


def test_packed_values_are_compressed_json_and_the_same_each_time():
    value = {"a": [1, 2.5], "b": "ü"}
    text = packing.pack(value)
    assert json.loads(gzip.decompress(base64.b64decode(text))) == value
    assert packing.pack(value) == text


def test_numbers_too_large_for_two_bytes_are_named():
    with pytest.raises(ValueError, match="32768"):
        packing.numbers([32768.0], "<i2")
    found = np.frombuffer(base64.b64decode(packing.numbers([-3.4, 7.0], "<i2")), "<i2")
    assert found.tolist() == [-3, 7]


def test_the_table_of_a_mixture_holds_its_means():
    table = content.mixture("moving_modes")
    c = torch.linspace(-1, 1, content.TABLE)[:, None]
    expected = moving_modes().components(c).means
    assert np.abs(np.array(table["means"]) - expected.numpy()).max() < 1e-5


def test_colours_are_those_of_the_figures():
    looks = content.colours()["looks"]
    assert {name: look["color"] for name, look in looks.items()} == {
        name: look.color for name, look in LOOKS.items()
    }
