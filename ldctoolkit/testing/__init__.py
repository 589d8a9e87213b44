"""The contracts of controllers, metrics and vehicle models, as checks that their authors run in tests of their own.

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
from ldctoolkit.testing.vehicle import check_vehicle_model

__all__ = [
    "CHECKS",
    "ContractError",
    "ContractSettings",
    "ControllerContract",
    "Fault",
    "check_controller_contract",
    "check_metric",
    "check_vehicle_model",
    "contract_faults",
]
