from controllers import *
from controllers import _mpc_condensing as _mpc_condensing
from controllers import barrier_filter as barrier_filter
from controllers import linear_mpc as linear_mpc
from controllers import pid as pid
from controllers import pure_pursuit as pure_pursuit
from controllers import sliding_mode as sliding_mode
from controllers import stanley as stanley
