"""Mixture benchmark at the source paper's size: 529,096 events of 8 parameters, K = 10, against scikit-learn's mixture.

scikit-learn's `GaussianMixture` knows no bounds; it is the named reference for time and memory because it is what one
would use otherwise. Events are drawn from the bundled model `reference`. Ratios come from one run; print them with
`make bench`. The choice of K over 1 to 15 on both sides takes some minutes; `--no-selection` leaves it out."""

import argparse
import platform
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from history import report
from sklearn.mixture import GaussianMixture

from ldctoolkit import BoundedGaussianMixture, load_model
from ldctoolkit.mixture import TruncatedNormal, select_components

N, K, TOL = 529_096, 10, 1e-6
SHORT, LONG = 2, 8

MEMORY = """
import sys, warnings
import numpy as np
from pathlib import Path
warnings.simplefilter("ignore")
folder, which = Path(sys.argv[1]), sys.argv[2]
x = np.load(folder / "events.npy")
if which == "ours":
    from ldctoolkit import BoundedGaussianMixture, load_model
    side = load_model("reference").left
    def fit(rows):
        BoundedGaussianMixture(10, lower=side.lower, upper=side.upper, random_state=0, max_iter=10).fit(rows)
else:
    from sklearn.mixture import GaussianMixture
    def fit(rows):
        GaussianMixture(10, random_state=0, max_iter=10).fit(rows)
fit(x[:30_000])  # libraries, compiled code and thread pools are there before the count begins
def status(key):
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith(key))
Path("/proc/self/clear_refs").write_text("5")  # the peak starts at what is held now
before = status("VmRSS")
fit(x)
print((status("VmHWM") - before) / 1024)
"""


def seconds(run: Callable[[], object], repeats: int = 1) -> float:
    """Best of several runs."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times)


def passes(X: np.ndarray, side: BoundedGaussianMixture) -> tuple[float, float]:
    """Seconds per pass, ours with moments and M-step and scikit-learn's: the difference between two lengths of run."""

    def ours(n: int) -> None:
        model = BoundedGaussianMixture(
            K, lower=side.lower, upper=side.upper, n_init=1, split_merge=False, tol=0.0, max_iter=n, random_state=0
        )
        model.fit(X)

    def theirs(n: int) -> None:
        start = {"weights_init": side.weights_, "means_init": side.means_}
        precisions = np.linalg.inv(side.covariances_)
        GaussianMixture(K, tol=0.0, max_iter=n, random_state=0, precisions_init=precisions, **start).fit(X)

    return tuple(  # type: ignore[return-value]
        (seconds(lambda run=run: run(LONG), 3) - seconds(lambda run=run: run(SHORT), 3)) / (LONG - SHORT)
        for run in (ours, theirs)
    )


def whole_run(X: np.ndarray, side: BoundedGaussianMixture) -> float:
    """Seconds per pass of a whole fit, its start and all lattice points at the end included."""
    model = BoundedGaussianMixture(K, lower=side.lower, upper=side.upper, n_init=1, split_merge=False, random_state=0)
    time_taken = seconds(lambda: model.fit(X))
    return time_taken / model.n_iter_


def memory(X: np.ndarray) -> tuple[float, float]:
    """Peak memory above the data [MiB], each in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder) / "events.npy", X)
        return tuple(  # type: ignore[return-value]
            float(subprocess.run([sys.executable, "-c", MEMORY, folder, which], capture_output=True, check=True).stdout)
            for which in ("ours", "scikit-learn")
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--no-selection", action="store_true", help="leave out the choice of K, which takes minutes")
    chosen = parser.parse_args()
    warnings.simplefilter("ignore")
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}; {N:,} x 8, K = {K}")
    reference = load_model("reference")
    side = reference.left
    X = side.sample(N, 1)[0]

    ours, theirs = passes(X, side)
    print(
        f"EM pass on 1,021 lattice points: {1e3 * ours:.0f} ms, scikit-learn {1e3 * theirs:.0f} ms an iteration: "
        f"ratio {ours / theirs:.3f} (limit 0.10)"
    )
    report("an EM pass", ours / theirs)
    average = whole_run(X, side)
    print(
        f"EM pass, average of a whole run that ends on 4,093 points: {1e3 * average:.0f} ms, "
        f"ratio {average / theirs:.3f} (limit 0.10)"
    )

    box = {"lower": side.lower, "upper": side.upper}
    model = BoundedGaussianMixture(K, random_state=0, tol=TOL, **box)
    ours = seconds(lambda: model.fit(X))
    gmm = GaussianMixture(K, random_state=0, tol=TOL, max_iter=2000)
    theirs = seconds(lambda: gmm.fit(X))
    print(
        f"whole fit to {TOL:g} nats: {ours:.1f} s with all starts ({model.n_iter_} passes, {model.stop_reason_}), "
        f"scikit-learn's single fit {theirs:.1f} s ({gmm.n_iter_} iterations): ratio {ours / theirs:.3f} (limit 0.2)"
    )
    report("whole fit", ours / theirs)
    print(f"log-likelihood above the truth's: {model.score(X) - side.score(X):+.5f} nats an event")

    ours, theirs = memory(X)
    ratio = ours / theirs
    print(f"peak memory above the data: {ours:.0f} MiB, scikit-learn {theirs:.0f} MiB: ratio {ratio:.3f} (limit 0.25)")

    report("peak memory above the data", ratio)
    low, high = np.asarray(side.lower), np.asarray(side.upper)
    for points in (1021, 4093):
        t = seconds(lambda n=points: TruncatedNormal(side.means_, side.covariances_, low, high, points=n), 20)
        print(
            f"moments of {K} components on {points:,} points: {1e3 * t:.1f} ms{' (limit 10)' if points < 4000 else ''}"
        )

    ours = seconds(lambda: side.sample(1_000_000, 0), 3)

    def rejection() -> None:
        kept = 0
        while kept < 1_000_000:
            rows = gmm.sample(1_000_000)[0]
            kept += int(np.all((rows > low) & (rows < high), axis=1).sum())

    theirs = seconds(rejection)
    ratio = ours / theirs
    print(
        f"1,000,000 events: {ours:.2f} s (limit 1.5), scikit-learn's fit by rejection {theirs:.2f} s: ratio {ratio:.2f}"
    )

    report("1,000,000 events drawn", ratio)
    if not chosen.no_selection:
        total = 0.0
        for name, mixture in (("left", reference.left), ("right", reference.right)):
            events = mixture.sample(N, 2)[0]
            start = time.perf_counter()
            found = select_components(events, range(1, 16), lower=mixture.lower, upper=mixture.upper, random_state=0)
            total += time.perf_counter() - start
            print(f"{name}: K = {found.best.n_components} of 1 to 15; {found.reason}")
        print(f"choice of K over 1 to 15, both sides: {total:.0f} s (limit 600)")


if __name__ == "__main__":
    main()
