"""The contract as a list of faults, as one call that raises, and as a class for pytest."""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import ClassVar, Final

from ldctoolkit.control import Controller
from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.law_checks import check_controller, raised
from ldctoolkit.testing import law_checks
from ldctoolkit.testing.subject import Check, ContractSettings, Subject

_TESTS: Final[dict[str, str]] = {
    "declared": "everything_it_takes_is_declared",
    "frozen": "designs_are_frozen",
    "picklable": "designs_reach_worker_processes",
    "bounds": "bounds_are_enforced",
    "toml": "gains_round_trip_through_toml",
    "interface": "shapes_types_and_the_plant",
    "repeatable": "same_input_same_output",
    "mirror": "mirrored_input_gives_the_mirrored_command",
    "quiet": "quiet_on_a_straight_centred_road",
    "finite": "commands_are_finite",
    "limits": "declared_limits_are_kept",
    "inputs": "inputs_are_left_as_they_are",
    "state": "runs_share_no_state",
    "batch": "scenarios_do_not_depend_on_each_other",
    "take": "take_changes_no_command",
    "ended": "ended_scenarios_do_no_harm",
    "extremes": "extreme_gains_give_finite_commands",
}
"""Check -> its test in a `ControllerContract`, behind ``test_``."""

CHECKS: Final[dict[str, Check]] = {name: getattr(law_checks, name) for name in _TESTS}
"""Name -> check; the first line of a check's documentation states what it requires."""


@dataclasses.dataclass(frozen=True)
class Fault:
    """One thing that a design does against the contract."""

    design: str  # Name of the law, and the gains that differ from their defaults
    check: str  # Key of `CHECKS`
    sentence: str  # What is wrong, with the numbers, and what is allowed

    def __str__(self) -> str:
        return f"{self.design}: {self.check}: {self.sentence}"


class ContractError(LdcError, AssertionError):
    """A controller breaks its contract; the message holds one line a fault.

    Attributes
    ----------
    faults : tuple of Fault
    """

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults = tuple(faults)
        super().__init__("\n".join(map(str, self.faults)))


def contract_faults(
    controller: Controller | type[Controller],
    designs: Sequence[Controller] = (),
    *,
    checks: str | Iterable[str] | None = None,
    settings: ContractSettings | None = None,
) -> tuple[Fault, ...]:
    """Everything that a controller does against the contract.

    Raises `InputError` if what is given is no controller, or a check is not known.

    Parameters
    ----------
    controller : Controller or type
        A design, or a class, of which the design with all defaults is taken.
    designs : sequence of Controller
        More designs of the same law.
    checks : str or iterable of str, optional
        One key, or some keys, of `CHECKS`; all by default.
    settings : ContractSettings, optional
        Size and tolerances.

    Returns
    -------
    tuple of Fault
        Empty for a law that keeps the contract. Whatever the law raises is a fault too.

    Examples
    --------
    >>> from ldctoolkit import LQR
    >>> contract_faults(LQR(r_delta=50.0), checks=["mirror", "quiet", "finite"])
    ()
    """
    chosen = _chosen(checks)
    settings = ContractSettings() if settings is None else settings
    if not isinstance(settings, ContractSettings):
        raise InputError("settings", value=settings, allowed="ContractSettings(...), or None")
    first = controller() if isinstance(controller, type) and issubclass(controller, Controller) else controller
    every = [check_controller(design) for design in (first, *designs)]
    return tuple(fault for design in dict.fromkeys(every) for fault in _faults(design, chosen, settings))


def _chosen(checks: object) -> tuple[str, ...]:
    """Names of checks, each one known."""
    given = (checks,) if isinstance(checks, str) else CHECKS if checks is None else checks
    if not isinstance(given, Iterable):
        raise InputError("checks", value=given, allowed=f"one or more of {', '.join(CHECKS)}")
    chosen = tuple(given)
    for name in chosen:
        if not isinstance(name, str) or name not in CHECKS:
            raise InputError("checks", value=name, allowed=CHECKS)
    return chosen


def check_controller_contract(
    controller: Controller | type[Controller],
    designs: Sequence[Controller] = (),
    *,
    checks: str | Iterable[str] | None = None,
    settings: ContractSettings | None = None,
) -> None:
    """Raise a `ContractError` if a controller breaks the contract, one line a fault; parameters as `contract_faults`.

    Examples
    --------
    >>> from ldctoolkit import LQR
    >>> check_controller_contract(LQR, checks=["batch", "state"])
    """
    faults = contract_faults(controller, designs, checks=checks, settings=settings)
    if faults:
        raise ContractError(faults)


def _faults(design: Controller, checks: Iterable[str], settings: ContractSettings) -> Iterator[Fault]:
    changed = [f"{one.name}={getattr(design, one.name)}" for one in design.gains()
               if getattr(design, one.name) != one.default]  # fmt: skip
    called = ", ".join([design.name, *changed])
    for name in checks:
        try:
            for sentence in CHECKS[name](Subject(design, settings)):
                yield Fault(called, name, sentence)
        except (KeyboardInterrupt, GeneratorExit):
            raise
        except BaseException as error:  # a controller may be third-party code, and may call sys.exit
            yield Fault(called, name, raised(error))


class ControllerContract:
    """The contract as tests: subclass it under pytest, in a class whose name starts with ``Test``.

    Examples
    --------
    >>> from ldctoolkit import LQR
    >>> class TestLQR(ControllerContract):
    ...     controller = LQR
    ...     designs = (LQR(r_delta=20.0),)
    >>> TestLQR().test_mirrored_input_gives_the_mirrored_command()
    """

    controller: ClassVar[type[Controller] | Controller]  # The law under test
    designs: ClassVar[Sequence[Controller]] = ()  # More designs of it than the one with all defaults
    settings: ClassVar[ContractSettings] = ContractSettings()  # Size and tolerances


def _test(check: str) -> Callable[[ControllerContract], None]:
    def test(self: ControllerContract) -> None:
        given = getattr(self, "controller", None)
        if given is None:
            raise InputError(f"{type(self).__name__}.controller", "missing", allowed="controller = MyLaw")
        check_controller_contract(given, self.designs, checks=(check,), settings=self.settings)

    test.__doc__ = f"Check `{check}`."
    return test


for _check, _name in _TESTS.items():
    setattr(ControllerContract, f"test_{_name}", _test(_check))
