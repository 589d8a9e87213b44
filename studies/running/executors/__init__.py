"""Where work runs: in this process, in processes of this machine, or on a Dask cluster."""

import os

from ldctoolkit.errors import InputError

from .processes import Ended, Executor, Work

EXECUTORS = ("serial", "processes", "dask")

__all__ = ["EXECUTORS", "Ended", "Executor", "Work", "make_executor"]


def make_executor(
    name: str | None, workers: int | None, address: str | None = None, packages: tuple[str, ...] = ()
) -> Executor:
    """The executor of that name: by default processes, one a core; serial where one worker is requested, dask where an
    address is given, of a scheduler or ``"local"``. The versions of `packages` must be the same on a cluster.
    """
    if address is not None and not address.strip():
        raise InputError("dask", value=address, allowed="an address such as tcp://host:8786, or 'local'")
    if name is None:
        name = "dask" if address else "serial" if workers == 1 else "processes"
    if name not in EXECUTORS:
        raise InputError("executor", value=name, allowed=EXECUTORS)
    if address and name != "dask":
        raise InputError("executor", f"with the address {address}", value=name, hint="allowed with an address: 'dask'")
    # each is loaded on first use: a run in this process needs neither loky nor Dask
    if name == "serial":
        from .processes import SerialExecutor

        return SerialExecutor()
    if name == "dask":
        from .dask_cluster import LOCAL, DaskExecutor

        if address and address != LOCAL and workers is not None:
            raise InputError("workers", f"{workers} with the cluster at {address}", allowed="that cluster's own number")
        return DaskExecutor(address or LOCAL, workers, packages)
    from .processes import ProcessExecutor

    return ProcessExecutor(workers or os.cpu_count() or 1)
