from studies import *
