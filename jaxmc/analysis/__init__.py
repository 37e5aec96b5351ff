"""What the samples say: reads tallies, never draws a sample."""

from . import attribution as attribution
from . import bias as bias
from . import clamped_means as clamped_means
from . import clamping as clamping
from . import convergence as convergence
from . import coverage as coverage
from . import depths as depths
from . import fireflies as fireflies
from . import metrics as metrics
from . import pixels as pixels
from . import reweighting as reweighting
from . import robust as robust
from . import tails as tails
from . import waits as waits
