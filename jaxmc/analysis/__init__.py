"""What the samples say: reads tallies, never draws a sample."""

from . import attribution as attribution
from . import clamping as clamping
from . import convergence as convergence
from . import coverage as coverage
from . import fireflies as fireflies
from . import tails as tails
