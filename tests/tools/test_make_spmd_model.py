"""The recipe for a model of the SPMD recordings, with a server in this process that stands for the data set's."""

import dataclasses
import hashlib
import io
import re
import socket
import threading
import zipfile
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers import round_trip as making
from helpers import spmd
from helpers.cli import tool
from ldctoolkit import load_model, read_departures

recipe = tool("make_spmd_model")

CONTENT = np.random.default_rng(1).bytes(3_000_000)
OTHER = np.random.default_rng(2).bytes(2_500_000)


@dataclasses.dataclass
class Server:
    """What the stand-in serves, how it behaves, and what it was asked for."""

    address: str = ""
    files: dict[str, bytes] = dataclasses.field(default_factory=dict)
    headers: dict[str, str] = dataclasses.field(default_factory=lambda: {"ETag": '"first"'})
    ranges: bool = True
    if_range: bool = True
    cuts: list[int] = dataclasses.field(default_factory=list)  # each of the next answers ends after so many bytes
    statuses: list[int] = dataclasses.field(default_factory=list)  # of the next answers, 200 for as usual
    asked: list[tuple[str, str | None]] = dataclasses.field(default_factory=list)  # path and Range
    sent: list[int] = dataclasses.field(default_factory=list)  # bytes of each answer


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    state = Server()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            wanted = self.headers.get("Range")
            state.asked.append((self.path, wanted))
            content = state.files.get(self.path.partition("?")[0])
            status = state.statuses.pop(0) if state.statuses else 200
            if content is None or status != 200:
                self.send_error(404 if content is None else status)
                return
            known = [value for value in state.headers.values() if not value.startswith("W/")]  # RFC 9110, 13.1.5
            same = self.headers.get("If-Range") in known or not state.if_range
            begin = int(wanted.removeprefix("bytes=").removesuffix("-")) if wanted and state.ranges and same else 0
            if begin >= len(content):
                self.send_error(416)
                return
            self.send_response(206 if begin else 200)
            for name, value in state.headers.items():
                self.send_header(name, value)
            if begin:
                self.send_header("Content-Range", f"bytes {begin}-{len(content) - 1}/{len(content)}")
            self.send_header("Content-Length", str(len(content) - begin))
            self.end_headers()
            body = content[begin:][: state.cuts.pop(0) if state.cuts else None]
            state.sent.append(len(body))
            self.wfile.write(body)

        def log_message(self, *_: Any) -> None:
            pass

    monkeypatch.setattr(recipe.time, "sleep", lambda _: None)
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as running:
        threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.01}).start()
        state.address = f"http://127.0.0.1:{running.server_port}"
        yield state
        running.shutdown()


def refused() -> str:
    """An address that nothing listens at."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{one.getsockname()[1]}"


def sentence(capsys: pytest.CaptureFixture[str]) -> str:
    """The last line on stderr, which must be one of the tool or of ldc."""
    lines = capsys.readouterr().err.splitlines()
    assert not any("Traceback" in line for line in lines)
    assert re.match(r"(make_spmd_model|ldc): error: ", lines[-1]), lines
    return lines[-1]


def packed(**members: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name.replace("__", "/").replace("_csv", ".csv"), content)
    return stream.getvalue()


@pytest.mark.slow
def test_from_the_server_to_a_checked_model(server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive = making.drive(load_model("reference").sample(60, 60, seed=11), 5)
    lane, wsu = making.write_tables(tmp_path, making.measure(drive, making.Noise(), 7))
    archive = packed(day__DataLane_csv=lane.read_bytes(), DataLane_Summary_csv=b"x", day__DataDas_csv=b"y")
    server.files = {"/SPMD.zip": archive, "/files/2bf7": wsu.read_bytes()}
    urls = [f"{server.address}/SPMD.zip", f"DataWsu.csv={server.address}/files/2bf7?download=1"]
    sums = ["--sha256", f"SPMD.zip={hashlib.sha256(archive).hexdigest().upper()}"]
    out = tmp_path / "out"
    command = [*urls, "-o", str(out), "--accept-terms", *sums]
    assert recipe.main(command) == 0
    printed = capsys.readouterr().out
    assert "https://data.transportation.gov/Automobiles/Safety-Pilot-Model-Deployment-Data/a7qq-9vfe" in printed
    assert printed.index("The terms on that page hold") < printed.index("SPMD.zip: ")
    assert "right: the model gives the recordings' answer (all 12 test designs lie within" in printed
    departures, provenance = read_departures(out / "departures.parquet")
    assert 115 <= len(departures) <= 120
    assert (provenance.criteria.vehicle_width, provenance.preparation.yaw_rate_factor) == (1.82, 1.0)
    model = load_model(str(out / "model.json"))
    assert model.provenance.source["files"] == ["SPMD_day_DataLane.csv", "DataWsu.csv"]
    assert (out / "model.html").is_file()
    assert (out / "extraction.html").is_file()
    # again: nothing is asked for and nothing made
    before, asked = {path: path.stat().st_mtime_ns for path in out.rglob("*")}, len(server.asked)
    assert recipe.main(command) == 0
    assert "SPMD.zip: " in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == before
    assert len(server.asked) == asked == 2
    # another width: the old departures and the old model are not taken
    assert recipe.main([*command, "--vehicle-width", "0.5"]) == 2
    assert "allowed: at least 30 a side" in sentence(capsys)
    assert read_departures(out / "departures.parquet")[1].criteria.vehicle_width == 0.5


def test_tables_of_the_second_fleet(server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive = spmd.planted_drive(1, 2)
    drive = dataclasses.replace(drive, yaw_rate=-drive.yaw_rate)  # positive to the right, as in the public sample
    lines = [spmd.HEADER, *spmd.lines_of(spmd.rows_of(drive))]
    server.files = {"/SPMD.zip": packed(HV_Primary_csv="\n".join(lines).encode(), DataLane_csv=b"other")}
    command = [f"{server.address}/SPMD.zip", "-o", str(tmp_path), "--accept-terms", "--format", "spmd-das2"]
    assert recipe.main([*command, "--yaw-rate-factor", "-1"]) == 2
    assert "4 left and 4 right; allowed: at least 30 a side" in sentence(capsys)
    departures, provenance = read_departures(tmp_path / "departures.parquet")
    assert (len(departures), provenance.reader) == (8, "spmd-das2")
    assert provenance.preparation.yaw_rate_factor == -1.0


def test_nothing_is_downloaded_before_the_terms_are_accepted(
    server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server.files = {"/DataLane.csv": b"x"}
    assert recipe.main([f"{server.address}/DataLane.csv", "-o", str(tmp_path / "out")]) == 2
    shown = capsys.readouterr()
    assert "Publisher: US Department of Transportation" in shown.out
    assert shown.err == "make_spmd_model: nothing was downloaded; go on with --accept-terms\n"
    assert server.asked == []
    assert list(tmp_path.iterdir()) == []


def test_a_cut_connection_is_taken_up_where_it_ended(server: Server, tmp_path: Path) -> None:
    server.files, server.cuts = {"/a.csv": CONTENT}, [1_000_000, 500_000]
    recipe.download(f"{server.address}/a.csv", tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_bytes() == CONTENT
    assert [one for _, one in server.asked] == [None, "bytes=1000000-", "bytes=1500000-"]
    assert server.sent == [1_000_000, 500_000, 1_500_000]
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


@pytest.mark.parametrize(
    "headers", [{"ETag": '"a"'}, {"ETag": 'W/"a"', "Last-Modified": "Mon, 01 Jan 2024 00:00:00 GMT"}]
)
def test_the_next_run_asks_only_for_what_is_missing(
    server: Server, tmp_path: Path, headers: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    server.files, server.headers = {"/a.csv": CONTENT}, headers
    server.cuts, server.statuses = [1_000_000], [200, *[503] * 5]
    command = [f"{server.address}/a.csv", "-o", str(tmp_path), "--accept-terms"]
    assert recipe.main(command) == 2
    assert "a.csv: HTTP Error 503: Service Unavailable" in (said := sentence(capsys))
    assert said.endswith("given up: 5 attempts brought nothing new")
    assert not (tmp_path / "downloads" / "a.csv").exists()
    server.asked.clear()
    assert recipe.main(command) == 2  # no table, which the reader finds
    assert server.asked == [("/a.csv", "bytes=1000000-")]
    assert server.sent == [1_000_000, 2_000_000]
    assert (tmp_path / "downloads" / "a.csv").read_bytes() == CONTENT


def test_an_interrupted_run_goes_on(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(_: float) -> None:
        raise KeyboardInterrupt

    server.files, server.cuts = {"/a.csv": CONTENT}, [2_999_999]
    command = [f"{server.address}/a.csv", "-o", str(tmp_path), "--accept-terms"]
    with monkeypatch.context() as patch:
        patch.setattr(recipe.time, "sleep", interrupt)
        assert recipe.main(command) == 130
    assert capsys.readouterr().err.endswith("make_spmd_model: interrupted; the same command goes on with the rest\n")
    recipe.main(command)
    assert server.sent == [2_999_999, 1]
    assert (tmp_path / "downloads" / "a.csv").read_bytes() == CONTENT


def test_a_server_without_ranges_sends_all_again(server: Server, tmp_path: Path) -> None:
    server.files, server.cuts, server.ranges = {"/a.csv": CONTENT}, [1_000_000], False
    recipe.download(f"{server.address}/a.csv", tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_bytes() == CONTENT
    assert server.sent == [1_000_000, 3_000_000]


def test_without_a_mark_of_its_state_a_file_is_not_pieced_together(server: Server, tmp_path: Path) -> None:
    server.files, server.cuts, server.headers = {"/a.csv": CONTENT}, [1_000_000], {}
    recipe.download(f"{server.address}/a.csv", tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_bytes() == CONTENT
    assert [one for _, one in server.asked] == [None, None]


@pytest.mark.parametrize("if_range", [True, False])
@pytest.mark.parametrize("content", [OTHER, OTHER[:900_000]], ids=["shorter", "shorter than the part"])
def test_a_changed_file_starts_again(server: Server, tmp_path: Path, if_range: bool, content: bytes) -> None:
    server.files, server.cuts, server.statuses = {"/a.csv": CONTENT}, [1_000_000], [200, *[503] * 5]
    with pytest.raises(recipe.RecordingError, match="given up"):
        recipe.download(f"{server.address}/a.csv", tmp_path / "a.csv")
    server.files, server.headers, server.if_range = {"/a.csv": content}, {"ETag": '"second"'}, if_range
    recipe.download(f"{server.address}/a.csv", tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_bytes() == content


def test_endless_cuts_end(server: Server, tmp_path: Path) -> None:
    """Without ranges every attempt begins anew: none gets farther than the first."""
    server.files, server.cuts, server.ranges = {"/a.csv": CONTENT}, [1_000_000] * 99, False
    with pytest.raises(recipe.RecordingError, match=r"cut after 1,000,000 of 3,000,000 bytes .* given up: 5 attempts"):
        recipe.download(f"{server.address}/a.csv", tmp_path / "a.csv")
    assert len(server.sent) == 6


def test_a_file_with_another_checksum_is_not_used(
    server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server.files = {"/DataLane.csv": CONTENT}
    command = [f"{server.address}/DataLane.csv", "-o", str(tmp_path), "--accept-terms", "--sha256"]
    right = hashlib.sha256(CONTENT).hexdigest()
    assert recipe.main([*command, f"DataLane.csv={'0' * 64}"]) == 2
    part = tmp_path / "downloads" / "DataLane.csv.part"
    assert f"DataLane.csv: SHA-256 is {right}, not {'0' * 64}; not used; delete {part} to retry" in sentence(capsys)
    assert not part.with_suffix("").exists()
    assert not (tmp_path / "departures.parquet").exists()
    # the mistake was in the checksum: nothing is downloaded again
    recipe.main([*command, f"DataLane.csv={right}"])
    assert part.with_suffix("").read_bytes() == CONTENT
    assert len(server.asked) == 1
    # a file that is there is checked, too
    part.with_suffix("").write_bytes(OTHER)
    capsys.readouterr()
    assert recipe.main([*command, f"DataLane.csv={right}"]) == 2
    assert f"not used; delete {part.with_suffix('')} to retry" in sentence(capsys)


def test_what_cannot_be_fetched_is_one_sentence(
    server: Server, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rest = ["-o", str(tmp_path), "--accept-terms"]
    assert recipe.main([f"{server.address}/gone.zip", *rest]) == 2
    assert sentence(capsys).startswith("make_spmd_model: error: gone.zip: HTTP Error 404: Not Found (http://127.0.0.1:")
    assert len(server.asked) == 1
    assert recipe.main([f"{refused()}/DataLane.csv", *rest]) == 2
    assert "Connection refused" in sentence(capsys)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (packed(readme_csv=b"x"), "a.zip: holds no table of spmd-das1; it holds readme.csv"),
        (
            packed(DataLane_csv=b"abc" * 99).replace(b"PK\x03\x04", b"PK\x03\x05"),
            "a.zip: cannot be unpacked: Bad magic",
        ),
        (b"<html>log in</html>", "no table DataLane"),
    ],
    ids=["another table", "damaged", "a page"],  # an archive holds the time: two workers would collect other names
)
def test_what_holds_no_table_is_one_sentence(
    server: Server, tmp_path: Path, content: bytes, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    server.files = {"/a.zip": content}
    assert recipe.main([f"{server.address}/a.zip", "-o", str(tmp_path), "--accept-terms"]) == 2
    assert message in sentence(capsys)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["ftp://x/DataLane.csv"], "allowed: NAME=..."),
        (["a=ftp://x/DataLane.csv"], "allowed: URL or NAME=URL, the http or https address of a file"),
        (["http://x/"], "allowed: URL or NAME=URL"),
        (["../up=http://x/a"], "allowed: URL or NAME=URL"),
        (["http://x/Spur%20ä.csv"], "allowed: URL or NAME=URL, the http or https address of a file, in ASCII without"),
        (["a=http://x/two words.csv"], "allowed: URL or NAME=URL"),
        (["http://x/one/a.csv", "http://x/two/a.csv"], "files of one name: a.csv, a.csv; allowed: others, as NAME=URL"),
        (["http://x/DataLane.csv", "--sha256", "DataLan.csv=00"], "no such file; did you mean 'DataLane.csv'?"),
    ],
)
def test_wrong_arguments(words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code = recipe.main([*words, "-o", str(tmp_path / "out"), "--accept-terms"])
    except SystemExit as stop:
        code = stop.code
    assert code == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
