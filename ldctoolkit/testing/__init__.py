"""The contract that every controller keeps, as checks that its author runs in tests of their own; and that of a metric.

Under pytest, subclass `ControllerContract`; without it, call `check_controller_contract`. Nothing here needs pytest.
"""

from ldctoolkit.testing.contract import (
    CHECKS,
    ContractError,
    ControllerContract,
    Fault,
    check_controller_contract,
    contract_faults,
)
from ldctoolkit.testing.metric_contract import check_metric
from ldctoolkit.testing.subject import ContractSettings

__all__ = [
    "CHECKS",
    "ContractError",
    "ContractSettings",
    "ControllerContract",
    "Fault",
    "check_controller_contract",
    "check_metric",
    "contract_faults",
]
