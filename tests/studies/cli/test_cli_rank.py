"""``ldc rank`` as people meet it: the study's own ranking again, other settings, one message for wrong input."""

import contextlib
import csv
import json
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from helpers.cli import Terminal, bad, good, ldc
from ldctoolkit.studies import Study, run_study
from ldctoolkit.studies.cli import main


@pytest.fixture
def rank(folder: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        done = ldc("rank", *arguments, cwd=folder)
        assert done.returncode == 0, done.stderr
        return done

    return run


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def stored(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def column(rows: Iterable[dict[str, str]], name: str) -> list[str]:
    return [row[name] for row in rows]


Rank = Callable[..., subprocess.CompletedProcess[str]]


def test_the_studys_own_ranking(folder: Path, rank: Rank) -> None:
    done = rank("plain", "--top", 1)
    assert "4 designs" in done.stdout
    assert "fresh scenarios" in done.stdout
    assert done.stdout.splitlines()[-1] == f"ranking: {Path('plain') / 'ranking.csv'}"
    assert column(rows_of(folder / "plain" / "ranking.csv"), "rank") == ["1", "2", "3", "4"]
    assert rank("plain", "--quiet").stdout == f"ranking: {Path('plain') / 'ranking.csv'}\n"
    # what is asked for and is the study's own changes nothing
    same = rank("plain", "--confidence", 0.95, "--quiet")
    assert (same.stdout, same.stderr) == (f"ranking: {Path('plain') / 'ranking.csv'}\n", "")


def test_the_table_shows_what_the_file_holds(folder: Path, rank: Rank) -> None:
    """Every cell to the digits that are printed."""
    lines = rank("plain", "--top", 4).stdout.splitlines()
    rows = rows_of(folder / "plain" / "ranking.csv")
    shown = [line for line in lines if re.match(r" *\d .*\d\.\.\d", line)]
    assert len(rows) == len(shown) == 4
    for line, row in zip(shown, rows, strict=True):
        cell = "([-\\d.\u2013]+) +"
        pattern = rf" *(\d) (.+?) +{cell}.*?([\d.]+) +([\d.]+)\.\.([\d.]+) +{3 * cell}([\d.]+) +{cell}(.*)$"
        found = re.match(pattern, line)
        assert found is not None, line
        rank_, _, y_s, S, low, high, saved, a_y, jerk, needless, fresh, verdict = found.groups()
        assert (rank_, float(y_s)) == (row["rank"], float(row["y_s_m"]))
        assert float(S) == pytest.approx(float(row["S_m_s"]), abs=6e-4)
        assert (float(low), float(high)) == pytest.approx((float(row["S_low_m_s"]), float(row["S_high_m_s"])), abs=6e-4)
        assert float(saved) == pytest.approx(100 * float(row["reduction"]), abs=0.06)
        assert float(needless) == pytest.approx(100 * float(row["needless_share"]), abs=0.06)
        assert (fresh == "–") == (row["fresh_S_m_s"] == "")  # noqa: RUF001
        for cell, name in ((a_y, "a_y_added_peak_p95_m_s2"), (jerk, "jerk_added_peak_p95_m_s3")):
            assert (cell == "–") == (row[name] == "")  # noqa: RUF001
            assert row[name] == "" or float(cell) == pytest.approx(float(row[name]), abs=6e-3)
        assert ("winner" in verdict) == (row["winner"] == "true")


def printed(*arguments: str, cwd: Path, columns: int, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Lines on a terminal so wide, without colours."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", str(columns))
    with contextlib.chdir(cwd), contextlib.redirect_stdout(Terminal()) as out:
        main(arguments)
    return re.sub(r"\x1b\[[0-9;]*m", "", out.getvalue()).splitlines()


@pytest.mark.parametrize(
    "command",
    [
        "rank plain", "review linear_mpc", "review plain", "compare plain other", "risk plain -n 200 --workers 1",
        "assess lqr --standard un-r79-b1", "controllers", "sensitivity plain --points 3",
    ],
)  # fmt: skip
def test_no_table_loses_a_digit_at_80_columns(command: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The numbers of a wide terminal, none cut, in lines that fit; sentences below a table may be longer."""

    def numbers(lines: list[str]) -> Counter[str]:
        return Counter(word for line in lines for word in re.findall(r"[-+]?\d[\d.,e+-]*", line))

    shutil.copytree(folder / "plain", folder / "other")
    if command.startswith("risk"):  # the first time it also says how long it takes
        printed(*command.split(), cwd=folder, columns=80, monkeypatch=monkeypatch)
    wide = printed(*command.split(), cwd=folder, columns=220, monkeypatch=monkeypatch)
    narrow = printed(*command.split(), cwd=folder, columns=80, monkeypatch=monkeypatch)
    assert not any("\u2026" in line for line in narrow)
    # first columns may stand there again
    assert not numbers(wide) - numbers(narrow), numbers(wide) - numbers(narrow)
    assert {line for line in narrow if len(line) > 80} <= set(wide)


def test_the_table_is_readable_at_80_columns(folder: Path) -> None:
    """Nothing is cut with an ellipsis, no line is longer than the terminal."""
    command = f"stty cols 80; {sys.executable} -m ldctoolkit rank plain"
    done = subprocess.run(
        ["script", "-qec", command, "/dev/null"], cwd=folder, capture_output=True, text=True, check=True
    )
    lines = [re.sub(r"\x1b\[[0-9;]*m", "", line).rstrip() for line in done.stdout.splitlines()]
    assert max(map(len, lines)) <= 80
    assert "…" not in done.stdout
    text = " ".join(" ".join(lines).split())
    for heading in ("a_y", "Jerk", "p95", "Reduction", "Verdict", "Gains"):
        assert heading in text
    assert "Smallest S" in text


def test_an_inadmissible_design_is_never_first_without_a_word(folder: Path, rank: Rank) -> None:
    done = rank("plain", "--require", "comfort", "--require", "S <= 1e-3")
    assert "None of 3 designs meets the limits." in done.stdout
    assert "Nearest: " in done.stdout
    assert all(line.lstrip().startswith("–") for line in done.stdout.splitlines() if "breaks" in line and ".." in line)  # noqa: RUF001


def test_other_requirements_rank_others_and_change_no_file(folder: Path, rank: Rank, tmp_path: Path) -> None:
    rank("plain", "--quiet")
    before = stored(folder / "plain")
    S = {row["design"]: float(row["S_m_s"]) for row in rows_of(folder / "plain" / "ranking.csv")}
    best, second = sorted(S, key=lambda design: S[design])[:2]
    target = tmp_path / "r.csv"
    text = f"S > {S[best] + 1e-9!r}"
    done = rank("plain", "--require", text, "--require", "triggered >= 0", "-o", target)
    assert stored(folder / "plain") == before
    rows = rows_of(target)
    assert (rows[0]["design"], rows[0]["rank"]) == (second, "1")
    assert (rows[-1]["design"], rows[-1]["rank"], rows[-1]["unmet"] != "") == (best, "", True)
    # who the finalists are was decided without the requirement
    assert "fresh scenarios" not in done.stdout
    assert set(column(rows, "fresh_S_m_s")) == {""}
    assert re.fullmatch(r"ldc: warning: fresh scores are those of [^\n]+\n", done.stderr)
    assert done.stdout.splitlines()[-1] == f"ranking: {target}"


def test_another_baseline_and_front_keep_the_fresh_scores(folder: Path, rank: Rank, tmp_path: Path) -> None:
    target = tmp_path / "r.csv"
    done = rank("plain", "--baseline", "lqr", "--pareto", "S", "--pareto", "effort", "-o", target)
    assert done.stderr == ""
    assert "Pareto front over S, effort_mean" in done.stdout
    rows = rows_of(target)
    compared = [row for row in rows if row["law"] == "lqr" and row["y_s_m"] == "0.05"]
    assert column(compared, "baseline_difference_m_s") == ["0.0"]
    assert "Pareto" not in rank("plain", "--pareto", "", "-o", target).stdout


def test_more_confidence_makes_wider_intervals(folder: Path, rank: Rank, tmp_path: Path) -> None:
    rank("plain", "--quiet")
    done = rank("plain", "--confidence", 0.99, "-o", tmp_path / "r.csv")
    assert "99 %" in done.stdout
    own, wide = rows_of(folder / "plain" / "ranking.csv"), rows_of(tmp_path / "r.csv")
    assert column(own, "S_m_s") == column(wide, "S_m_s")
    assert all(float(b["S_low_m_s"]) < float(a["S_low_m_s"]) for a, b in zip(own, wide, strict=True))


def test_json(folder: Path, rank: Rank) -> None:
    own = json.loads(rank("plain", "--json").stdout)
    assert (own["event"], own["designs"], own["confidence"]) == ("ranked", 4, 0.95)
    assert own["ranking"] == str(Path("plain") / "ranking.csv")
    first = rows_of(folder / "plain" / "ranking.csv")[0]
    for name, column_name in {"S_m_s": "S_m_s", "S_low_m_s": "S_low_m_s", "S_high_m_s": "S_high_m_s",
                              "S_fresh_m_s": "fresh_S_m_s"}.items():  # fmt: skip
        assert own["winner"][name] == float(first[column_name]) > 0
    limits = {one["limit"]: one for one in own["winner"]["limits"]}
    jerk = limits["jerk_added_peak_p95 <= 5"]
    assert (jerk["required"], jerk["fresh"]) == (False, True)
    assert jerk["low"] == float(first["fresh_jerk_added_peak_p95_low_m_s3"]) <= jerk["value"]
    assert jerk["uncertain"] == (jerk["high"] is None or jerk["low"] <= 5.0 < jerk["high"])
    assert limits["lost <= 0"]["low"] is None
    assert own["winner"]["needless_share"] == 0.728
    assert "In 72.8 % of departures it intervenes needlessly" in own["sentences"][0]
    done = rank("plain", "--json", "--require", "S <= 0.0001")
    other = json.loads(done.stdout)
    assert done.stdout.count("\n") == 1
    assert (other["winner"], len(other["not_ranked"]), other["ranking"]) == (None, 4, None)
    assert other["require"] == ["S <= 0.0001"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["plain", "--require", "ay_p59 <= 3"], "did you mean 'a_y_peak_p95'"),
        (["plain", "--require", "S"], "allowed: a set (stable, comfort, lane-edge, acceptable, physical), or a metric"),
        (["plain", "--pareto", "effrt"], "did you mean 'effort"),
        (["plain", "--baseline", "lqq"], "did you mean 'lqr'"),
        (["plain", "--confidence", "1.5"], "plain: ranking.confidence: 1.5; allowed: less than 1"),
        (["plain", "--confidence", "high"], "allowed: a finite number"),
        (["plain", "-o", "r.txt"], "must end in .csv"),
        (["plain", "--require", "comfrt"], "'comfrt' is not a set of requirements; did you mean 'comfort'?"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_wrong_settings_get_one_message(arguments: list[str], message: str, folder: Path) -> None:
    assert message in bad("rank", *arguments, cwd=folder)


def test_the_time_of_a_step_is_shown_and_is_no_result(tmp_path: Path) -> None:
    """Of laws that are stepped, in the table, the JSON and the page; no file of the folder changes."""
    content = {
        "name": "timed",
        "scenarios": {"left": 12, "right": 8},
        "ranking": {"bootstrap": 200, "finalists": 0},
        "design": [{"law": "none"}, {"law": "lqr", "y_s": 0.05}, {"law": "pid", "y_s": 0.05}],
    }
    study = Study.from_dict(content)
    run_study(study, directory=tmp_path / "timed", workers=1, progress=False)
    good("report", "timed", "--no-robustness", "--no-figures", cwd=tmp_path)
    page = (tmp_path / "timed" / "report.html").read_text()
    assert page.count("Step 99 %") == 1
    assert "measured on this machine" in page
    before = stored(tmp_path / "timed")
    out = good("rank", "timed", "--timing", cwd=tmp_path)
    assert "measured on this machine" in out
    results = json.loads(good("rank", "timed", "--timing", "--json", cwd=tmp_path))["step_time_s"]
    assert "step_time_s" not in json.loads(good("rank", "timed", "--json", cwd=tmp_path))
    (pid,) = (design for design in study.designs if design.law == "pid")
    assert list(results) == [pid.id]
    assert 0.0 < results[pid.id]["median"] <= results[pid.id]["p99"] < 1.0
    (row,) = [line for line in out.splitlines() if re.match(r"\s*\d+ PID ", line)]
    (linear,) = [line for line in out.splitlines() if re.match(r"\s*\d+ LQR ", line)]
    assert linear.count("\u2013") == row.count("\u2013") + 2
    assert "Step" not in good("rank", "timed", cwd=tmp_path)
    assert stored(tmp_path / "timed") == before
    # the page is the same from the stored times
    good("report", "timed", "--no-robustness", "--no-figures", cwd=tmp_path)
    assert (tmp_path / "timed" / "report.html").read_text() == page
