from controllers import *
from controllers import _mpc_condensing as _mpc_condensing
from controllers import _nmpc_solver as _nmpc_solver
from controllers import _prediction_model as _prediction_model
from controllers import barrier_filter as barrier_filter
from controllers import external as external
from controllers import linear_mpc as linear_mpc
from controllers import pid as pid
from controllers import predictive as predictive
from controllers import pure_pursuit as pure_pursuit
from controllers import sliding_mode as sliding_mode
from controllers import stanley as stanley
