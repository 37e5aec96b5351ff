"""Tools for the tests of an estimator: yours as well as ours. Each passes only on evidence and says its power.

====================  ==================================================================================================
``assert_unbiased``    an ``Estimate`` against its true value
``assert_equivalent``  two ``Estimates`` of the same thing against each other
``assert_samples_pdf`` samples of a distribution against its density, by a chi-square test over bins of a ``Domain``
``assert_jacobian``    the density against the derivative of the map that draws, exactly, point by point
====================  ==================================================================================================

``Mix``, ``Pareto``, ``LogNormal``, ``Exponential``, ``ThroughputProduct`` and ``PathSum`` are laws of one sample of
which everything is known, ``DiskMollifier`` one of which the moments are. Whole estimators are checked against scenes
of known answer by ``analytic_scenes.check``.
"""

from .checks import ROUNDING as ROUNDING
from .checks import SIGMAS as SIGMAS
from .checks import assert_equivalent as assert_equivalent
from .checks import assert_unbiased as assert_unbiased
from .checks import joint_sigmas as joint_sigmas
from .chi_square import ChiSquare as ChiSquare
from .chi_square import chi_square_power as chi_square_power
from .domains import HEMISPHERE as HEMISPHERE
from .domains import SPHERE as SPHERE
from .domains import SQUARE as SQUARE
from .domains import Domain as Domain
from .domains import box as box
from .domains import directions as directions
from .laws import DiskMollifier as DiskMollifier
from .laws import Exponential as Exponential
from .laws import LogNormal as LogNormal
from .laws import Mix as Mix
from .laws import Pareto as Pareto
from .laws import ThroughputProduct as ThroughputProduct
from .path_sums import PathSum as PathSum
from .warps import assert_jacobian as assert_jacobian
from .warps import assert_samples_pdf as assert_samples_pdf
