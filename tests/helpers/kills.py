"""Processes that end at a chosen step of what they write, however fast the machine is."""

from pathlib import Path

_KILLING = """
import itertools, os, signal, sys

steps = itertools.count(1)

def watch(event, args):
    writes = event == "open" and args[2] & (os.O_WRONLY | os.O_RDWR)
    if writes or event in ("os.mkdir", "os.rename", "os.remove", "os.rmdir"):
        if isinstance(args[0], (str, os.PathLike)) and os.path.abspath(args[0]).startswith({where!r}):
            if next(steps) == {step}:
                os.kill(os.getpid(), signal.SIGKILL)

sys.addaudithook(watch)
"""


def killing(where: Path, step: int) -> str:
    """The begin of a program that is killed before it takes that step, its first being 1, in files whose path begins
    so. A step makes, writes, renames or removes one file or folder; what workers do is not counted.
    """
    return _KILLING.format(where=str(where), step=step)
