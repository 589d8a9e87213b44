"""Text of numbers against plain Python."""

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from helpers.examples import examples
from ldctoolkit.recordings.preparation import rising_rows
from ldctoolkit.recordings.uah_driveset import Column, read_number_text

COLUMNS = (Column(0, "time"), Column(1, "offset"), Column(3, "lane width"))
TOKENS = st.sampled_from(
    ["1", "2.5", "-9", "+3", ".5", "1e3", "-1E-3", "nan", "inf", "x", "1_0", "٣", "0x1", "1,5", "#", '"1"', "NULL", "é"]
)
LINES = st.lists(TOKENS, max_size=6).flatmap(
    lambda tokens: st.sampled_from([" ", "  ", "\t"]).map(lambda s: s.join(tokens))
)


@examples(300)
@given(st.lists(LINES, max_size=8), st.sampled_from(["\n", "\r\n", "\r"]), st.booleans())
def test_against_plain_python(lines, end, last):
    """Line by line with nothing but `split` and `float`."""
    text = end.join(lines) + (end if last else "")
    expected, faulty = [], []
    for line, content in enumerate(lines, start=1):
        tokens = content.split()
        if not tokens:
            continue
        used = [tokens[i] for i in (0, 1, 3) if i < len(tokens)]
        try:
            if len(used) < 3 or not "".join(used).isascii() or "_" in "".join(used):
                raise ValueError
            row = [float(token) for token in used]
            if not abs(row[0]) < 1e9:
                raise ValueError
            expected.append(row)
        except ValueError:
            faulty.append(line)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.txt")
        path.write_bytes(text.encode())
        values, problems = read_number_text(path, "a.txt", COLUMNS)
    if values is None:
        assert (len(problems), expected) == (1, [])
        return
    rows = np.array(expected)
    kept = rising_rows(rows[:, 0])
    np.testing.assert_array_equal(values, rows[kept])
    reported = [problem for problem in problems if "time runs" not in problem.what]
    assert [problem.place for problem in reported][:5] == [f"line {line}" for line in faulty[:5]]
    assert len(problems) - len(reported) == (not kept.all())
