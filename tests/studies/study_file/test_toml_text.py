"""A study written as TOML is the same study when it is read again."""

from pathlib import Path

import pytest

from ldctoolkit.studies.study_file import Study, catalog_names, load_study, toml_text


@pytest.mark.parametrize("name", catalog_names())
def test_the_same_study_comes_back(name: str, tmp_path: Path) -> None:
    study = load_study(name)
    assert study.name == name
    path = tmp_path / f"{name}.toml"
    path.write_text(toml_text(study), encoding="utf-8")
    again = load_study(str(path))
    assert (again.content(), again.hash) == (study.content(), study.hash)


def test_hard_text_comes_back(tmp_path: Path) -> None:
    title = 'a "quoted"  title, with [brackets],\n\\ and </script> ü'
    path = tmp_path / "first.toml"
    path.write_text(toml_text(load_study("paper").model_copy(update={"title": title})), encoding="utf-8")
    assert load_study(str(path)).title == title


@pytest.mark.parametrize("given", [(25.0, None), (None, 25.0), 25.0])
def test_conditions_with_an_open_end_come_back(given: object, tmp_path: Path) -> None:
    study = Study.from_dict({**load_study("paper").content(), "scenarios": {"left": 3, "given": {"v_mean": given}}})
    path = tmp_path / "given.toml"
    path.write_text(toml_text(study), encoding="utf-8")
    assert load_study(str(path)).content() == study.content()


def test_lists_stand_on_a_line_and_texts_keep_their_spaces(tmp_path: Path) -> None:
    study = load_study("paper")
    ranking = study.ranking.model_copy(update={"require": ("deeper <= 0.5",), "pareto": ("S", "deeper")})
    text = toml_text(study.model_copy(update={"ranking": ranking}))
    assert 'require = ["deeper <= 0.5"]' in text
    path = tmp_path / "second.toml"
    path.write_text(text, encoding="utf-8")
    again = load_study(str(path))
    assert (again.ranking.require, tuple(again.ranking.pareto)) == (("deeper <= 0.5",), ("S", "deeper"))
