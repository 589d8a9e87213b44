"""One departure of an outcome as a plot: position of the edge against time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from ldctoolkit.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ldctoolkit.scenarios import Scenarios
    from ldctoolkit.simulation.outcome import Outcome
    from ldctoolkit.vehicle import VehicleParameters

# Okabe and Ito (2008): distinguishable under the common colour vision deficiencies
_COLORS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_DASHES: Final = ("-", (0, (6.0, 2.0)), (0, (2.0, 1.5)), (0, (7.0, 2.0, 1.5, 2.0)), (0, (4.0, 1.5, 4.0, 4.0)))
_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X")
_PATH: Final = "path-with-control"  # identifier of the lines of paths, by which they are counted


def plot_departure(
    outcome: Outcome,
    i: int,
    ax: Axes | None = None,
    *,
    scenarios: Scenarios | None = None,
    vehicle: VehicleParameters | None = None,
    label: str = "with control",
) -> Axes:
    """Draw the path of one scenario under control, from the trigger on.

    Raises `InputError` if the outcome holds no trajectories, or not of this scenario.

    Parameters
    ----------
    outcome : Outcome
        With trajectories.
    i : int
        Number of the scenario.
    ax : Axes, optional
        To draw on; those of a new figure by default.
    scenarios : Scenarios, optional
        Those that were driven; the path without control, rebuilt from its parameters, is drawn too.
    vehicle : VehicleParameters, optional
        The one that was driven; the default one otherwise.
    label : str
        Of the path under control, in the legend.

    Returns
    -------
    Axes
        Position of the vehicle's edge beyond the line [m], outward, against the time since the crossing [s]. The marker
        is the trigger; a scenario that never triggered has no path under control. Paths on the same axes differ in
        colour, dash and marker.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("agg")
    >>> from ldctoolkit import LQR, Scenarios, plot_departure, simulate
    >>> scenarios = Scenarios.from_arrays(T=[3.0], d_y=0.6, v_mean=25.0, side=1)
    >>> ax = plot_departure(simulate(LQR(), scenarios, y_s=0.1, trajectories=True), 0, scenarios=scenarios)
    >>> ax.get_xlabel(), len(ax.get_legend().get_texts())
    ('Time since the crossing [s]', 2)
    """
    kept, n = outcome.trajectories, outcome.S.size
    if not 0 <= i < n:
        raise InputError("i", value=i, allowed=f"0 to {n - 1}")
    if scenarios is not None and scenarios.n != n:
        raise InputError("scenarios", f"{scenarios.n}, the outcome has {n}", allowed="those that were driven")
    if kept is None:
        raise InputError("outcome", "it holds no paths", hint="drive with trajectories=True a law that intervenes")
    at = np.flatnonzero(kept.rows == i)
    if not at.size:
        held = ", ".join(map(str, kept.rows[:5].tolist())) + (", ..." if kept.rows.size > 5 else "")
        raise InputError("i", f"{i} has no path in this outcome", allowed=held)
    import matplotlib.pyplot as plt

    from ldctoolkit.paths.uncorrected import UncorrectedPath
    from ldctoolkit.plant_options import Residuals
    from ldctoolkit.vehicle import VehicleParameters

    axes = plt.subplots(layout="constrained")[1] if ax is None else ax
    before = sum(line.get_gid() == _PATH for line in axes.lines)
    if not before:
        axes.axhline(0.0, color="#767676", linewidth=2.0, dashes=(7, 4), zorder=1)
    if scenarios is not None:
        one = scenarios.take([i])
        t = np.linspace(0.0, float(one.T[0]), 201)
        y = UncorrectedPath.of(one, Residuals(), 0).lateral(t[None, :])[0]
        axes.plot(t, y, color="#767676", linestyle=":", linewidth=1.8, label="without control")
    driven = np.isfinite(kept.t[at[0]])
    if driven.any():
        offset = (vehicle or VehicleParameters()).edge_offset
        t, y = kept.t[at[0], driven], kept.x[at[0], driven, 0] - offset
        color, dash, marker = (choices[before % len(choices)] for choices in (_COLORS, _DASHES, _MARKERS))
        axes.plot(t, y, linewidth=1.8, color=color, linestyle=dash, marker=marker, markevery=[0], label=label,
                  gid=_PATH)  # fmt: skip
    axes.set_xlabel("Time since the crossing [s]")
    axes.set_ylabel("Edge beyond the line [m]")
    axes.set_title(f"Scenario {i}")
    if scenarios is not None or driven.any():
        axes.legend()
    return axes
