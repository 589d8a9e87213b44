"""What docs/scenario-model.md shows and says is so."""

import dataclasses
import json
import re
from pathlib import Path

from ldctoolkit.scenario_model import FitSettings, ModelProvenance, SideSummary, load_model
from ldctoolkit.scenario_model.json_form import VERSION, model_to_json

PAGE = (Path(__file__).parents[3] / "docs" / "scenario-model.md").read_text(encoding="utf-8")


def test_the_code_runs(capsys):
    """One block goes on where the one before ended."""
    space = {}
    for code in re.findall(r"```python\n(.*?)```", PAGE, flags=re.S):
        exec(compile(code, "scenario-model.md", "exec"), space)
    assert (capsys.readouterr().out, len(space["motorway"])) == ("K = 1, as requested\n", 400)


def test_every_key_of_a_file_is_described():
    section = PAGE[PAGE.index("## File") : PAGE.index("## The bundled model")]
    described = set(re.findall(r"`\.?([a-z_]+)`", section))
    model = load_model("reference")
    content = model_to_json(model.left_side, model.right_side, model.provenance)
    keys = {*content, *content["sides"]["left"]} - {"sides"}
    for kind in (ModelProvenance, SideSummary, FitSettings):
        keys |= {field.name for field in dataclasses.fields(kind)}
    assert keys <= described, keys - described
    assert f"`, {VERSION} |" in section
    assert json.dumps(content)
