"""Make a scenario model of the public recordings of the Safety Pilot Model Deployment (SPMD).

    python tools/make_spmd_model.py --accept-terms -o out/spmd URL [NAME=URL ...] [--sha256 NAME=HEX]

Downloads files, unpacks their tables, extracts departures and fits a model; a stopped run goes on. The addresses of the
files may change, therefore they are arguments. No published checksum of them is known to us.
See docs/how-to/public-recordings.md.
"""

from __future__ import annotations

import argparse
import hashlib
import http.client
import json
import re
import shutil
import sys
import time
import urllib.request
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import urlsplit

from ldctoolkit import LdcError, __version__, check_fidelity, load_model, read_departures
from ldctoolkit.errors import InputError, RecordingError, nearest
from ldctoolkit.studies.cli import main as ldc
from ldctoolkit.studies.cli._console import named, number, progress_bar
from ldctoolkit.studies.storage.checked_parts import locked
from ldctoolkit.studies.storage.folder_files import output_folder, write_text

TERMS = """\
Data set:  Safety Pilot Model Deployment Data (identifier a7qq-9vfe)
Publisher: US Department of Transportation, ITS DataHub
Page:      https://data.transportation.gov/Automobiles/Safety-Pilot-Model-Deployment-Data/a7qq-9vfe
The terms on that page hold. Read them before use."""
TABLES = {"spmd-das1": r"data[ _-]?(lane|wsu)", "spmd-das2": r"hv[ _-]?primary"}  # their names in archives
RETRIES = 5  # attempts in a row that bring nothing new


def address(text: str) -> tuple[str, str]:
    """Name and address of a file: URL, or NAME=URL where the address does not end in its name."""
    name, url = (Path(urlsplit(text).path).name, text) if re.match("https?:", text) else named(text)
    if not re.fullmatch("https?://[!-.0-~][!-~]*", url) or not re.fullmatch(r"[^./\\][^/\\]*", name):
        allowed = "URL or NAME=URL, the http or https address of a file, in ASCII without blanks"
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: {allowed}")
    return name, url


def fetch(url: str, part: Path) -> None:
    """One attempt: ask for what `part` lacks; a `ConnectionError` if it still lacks something afterwards."""
    note = part.with_name(f"{part.name}.json")
    state = json.loads(note.read_text(encoding="utf-8")) if part.exists() and note.exists() else {}
    size = part.stat().st_size if state else 0
    if size and size == state["bytes"]:
        return  # stopped before it got its name
    request = urllib.request.Request(url, headers={"User-Agent": f"ldctoolkit/{__version__}"})
    if size and state["validator"]:
        request.headers.update({"Range": f"bytes={size}-", "If-range": state["validator"]})
    with progress_bar(part.stem) as progress, urllib.request.urlopen(request, timeout=60.0) as response:
        tag, total = response.headers.get("ETag", "W/"), int(response.headers.get("Content-Length", 0))
        validator = response.headers.get("Last-Modified", "") if tag.startswith("W/") else tag  # a weak tag is none
        if response.status == 206:
            span = re.fullmatch(r"bytes (\d+)-\d+/(\d+)", response.headers.get("Content-Range", ""))
            if span is None or int(span[1]) != size or validator not in ("", state["validator"]):
                part.unlink()  # the server does not know If-Range
                raise ConnectionError("not the missing part of the same file was sent")
            total = int(span[2])
        else:  # from the start: the old bytes go before the note describes the new ones
            part.write_bytes(b"")
            write_text(note, json.dumps({"validator": validator, "bytes": total}))
        with part.open("ab") as stream:
            while block := response.read(1 << 20):
                stream.write(block)
                if progress is not None and total:
                    progress(stream.tell(), total)
    if total and part.stat().st_size != total:
        raise ConnectionError(f"cut after {part.stat().st_size:,} of {total:,} bytes")


def download(url: str, target: Path, sha256: str | None = None) -> None:
    """Download a file, unless it is there; one with another SHA-256 than the given one is not used."""
    part, most, failures = target.with_name(f"{target.name}.part"), 0, 0
    file = target if target.exists() else part
    while file == part:
        try:
            fetch(url, part)
            break
        except (OSError, http.client.HTTPException) as error:  # of the network, most of them
            what = f"{target.name}: {str(error).strip('<>')} ({url})"
            status = getattr(error, "code", 500)  # of HTTP
            if status == 416:  # the file is shorter than its part
                part.unlink(missing_ok=True)
            elif status < 500 and status not in (408, 429):
                raise RecordingError(what) from None
            size = part.stat().st_size if part.exists() else 0
            most, failures = max(most, size), 0 if size > most else failures + 1
            if failures == RETRIES:
                raise RecordingError(f"{what}; given up: {RETRIES} attempts brought nothing new") from None
            print(f"{what}; another attempt", file=sys.stderr)
            time.sleep(2.0**failures)
    if sha256 is not None:
        with file.open("rb") as stream:
            found = hashlib.file_digest(stream, "sha256").hexdigest()
        if found != sha256.lower():
            raise RecordingError(f"{target.name}: SHA-256 is {found}, not {sha256}; not used; delete {file} to retry")
    file.replace(target)
    part.with_name(f"{part.name}.json").unlink(missing_ok=True)
    print(f"{target.name}: {target.stat().st_size:,} bytes{', there already' if file == target else ''}")


def tables_of(file: Path, folder: Path, reader: str) -> list[Path]:
    """The tables in a downloaded file; those of a ZIP archive are unpacked, since readers seek in plain text."""
    if not zipfile.is_zipfile(file):
        return [file]
    wanted = re.compile(rf"(.*/)?(?!\.|[^/]*summary)[^/]*({TABLES[reader]})[^/]*\.(csv|txt)", re.IGNORECASE)
    try:
        with zipfile.ZipFile(file) as packed:
            names = packed.namelist()
            tables = {n: folder / f"{file.stem}_{n.replace('/', '_')}" for n in names if wanted.fullmatch(n)}
            if not tables:
                raise RecordingError(f"{file.name}: holds no table of {reader}; it holds {', '.join(names[:50])}")
            for name, table in tables.items():
                if not table.exists() or table.stat().st_mtime_ns < file.stat().st_mtime_ns:
                    part = table.with_name(f"{table.name}.part")
                    with packed.open(name) as source, part.open("wb") as stream:
                        shutil.copyfileobj(source, stream, 1 << 20)
                    part.replace(table)
    except (zipfile.BadZipFile, EOFError, zlib.error, RuntimeError) as error:  # the last one: encrypted
        raise RecordingError(f"{file.name}: cannot be unpacked: {error}; delete {file} to try again") from None
    return list(tables.values())


def make(chosen: argparse.Namespace) -> int:
    files, sums = dict(chosen.files), dict(chosen.sha256)
    if len(files) < len(chosen.files):
        raise InputError(f"files of one name: {', '.join(n for n, _ in chosen.files)}; allowed: others, as NAME=URL")
    for name in sums.keys() - files.keys():
        raise InputError(f"--sha256 {name}: no such file; {nearest(name, files)}")
    folder = output_folder(chosen.output)
    with locked(folder):
        downloads, unpacked = output_folder(folder / "downloads"), output_folder(folder / "tables")
        for name, url in files.items():
            download(url, downloads / name, sums.get(name))
        tables = [table for name in files for table in tables_of(downloads / name, unpacked, chosen.format)]
        departures, model = folder / "departures.parquet", folder / "model.json"
        extract = ["extract", *map(str, tables), "-o", str(departures), f"--report={folder / 'extraction.html'}"]
        extract += [f"--format={chosen.format}", f"--vehicle-width={chosen.vehicle_width}"]
        extract += [f"--yaw-rate-factor={chosen.yaw_rate_factor}", *["--force"] * chosen.force]
        fit = ["fit", str(departures), "-o", str(model)]
        for output, command, inputs in ((departures, extract, tables), (model, fit, [departures])):
            states = [(str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in inputs]
            stamp, made_of = output.with_name(f"{output.name}.made"), json.dumps([__version__, command, states])
            if not output.exists() or not stamp.exists() or stamp.read_text(encoding="utf-8") != made_of:
                code = ldc(command)
                if code not in (0, 3):  # 3: some of the input could not be used
                    return code
                write_text(stamp, made_of)
        found, provenance = read_departures(departures)
        left, right = check_fidelity(load_model(str(model)), found)
    print(f"{model}\nleft: {left.text}\nright: {right.text}")
    return 3 if provenance.problems or not (left.passed and right.passed) else 0


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("files", nargs="+", type=address, metavar="[NAME=]URL", help="files of the data set, tables or ZIP archives")
    add("-o", "--output", type=Path, required=True, metavar="DIR", help="folder for downloads, tables and results")
    add("--accept-terms", action="store_true", help="you have read the terms on the page of the data set")
    add("--sha256", type=named, action="append", default=[], metavar="NAME=HEX", help="of a file; repeatable")
    add("--format", choices=TABLES, default="spmd-das1", help="which tables (default: %(default)s)")
    add("--vehicle-width", type=number, default=1.82, metavar="M", help="in m (default: %(default)s)")
    add("--yaw-rate-factor", type=number, default=1.0, metavar="X", help="-1 where it is positive to the right")
    add("--force", action="store_true", help="go on where a unit, a sign or a reference cannot be right")
    chosen = parser.parse_args(arguments)
    print(TERMS)
    if not chosen.accept_terms:
        print("make_spmd_model: nothing was downloaded; go on with --accept-terms", file=sys.stderr)
        return 2
    try:
        return make(chosen)
    except (LdcError, OSError) as error:
        print(f"make_spmd_model: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("make_spmd_model: interrupted; the same command goes on with the rest", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
