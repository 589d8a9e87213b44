"""Texts of a recording come from anybody's reader: they can be printed and stored, and recordings stay apart."""

import dataclasses
import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.recordings import drive
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings import Label, Preparation, extract_departures
from ldctoolkit.recordings.preparation import prepare

TEXT = st.text(st.characters(), max_size=4)  # lone surrogates, too


@given(TEXT.filter(bool), TEXT)
def test_any_text_can_be_printed(name: str, other: str) -> None:
    one = drive(name, source=other, notes=(other,), labels=(Label(name, other),))
    for text in (one.name, one.source, one.notes[0], one.labels[0].name, one.labels[0].value):
        assert text.isprintable()
        text.encode()
    if name.isprintable():
        assert one.name == name
    # what goes through the preparation is not made printable twice
    assert dataclasses.replace(prepare(one, Preparation(0.1)), name=one.name).name == one.name


NAMES = ("D1\udcff", "D1\udcfe", "D1\\udcff", "a\nb", "a\\nb", "a\x00b", "a b")


def test_names_stay_apart() -> None:
    assert len({drive(name).name for name in NAMES}) == len(NAMES)
    found = extract_departures([drive(name, source=name) for name in NAMES], vehicle_width=1.8)
    assert len(set(found.departures.recording.tolist())) == found.departures.n == len(NAMES)
    json.dumps([found.departures.recording.tolist(), found.warnings]).encode()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"name": 7}, "a recording's name is of type int; allowed: str"),
        ({"name": b"a"}, "a recording's name is of type bytes; allowed: str"),
        ({"name": ""}, "a recording's name is empty"),
        ({"source": None}, "recording 'a': source is of type NoneType; allowed: str"),
        ({"notes": "no GPS"}, "recording 'a': notes are 'no GPS'; allowed: a tuple of str"),
        ({"notes": ("no GPS", 3.5)}, r"recording 'a': notes are \('no GPS', 3.5\); allowed: a tuple of str"),
        ({"labels": ("driver",)}, r"recording 'a': labels are \('driver',\); allowed: a tuple of Label"),
    ],
)
def test_what_is_no_text_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(RecordingError, match=f"^{words}$"):
        drive(**changes)


@pytest.mark.parametrize(
    ("name", "value", "words"), [(7, "x", "name is of type int"), ("x", 7, "value is of type int")]
)
def test_labels_are_text(name: Any, value: Any, words: str) -> None:
    with pytest.raises(RecordingError, match=f"^a label's {words}; allowed: str$"):
        Label(name, value)
