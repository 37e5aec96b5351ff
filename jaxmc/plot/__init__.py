"""Figures: each function draws on the Axes that it is given. The only room that imports matplotlib."""

from ..pictures import tone_map as tone_map
from .curves import OTHER_MARKERS as OTHER_MARKERS
from .curves import OWN_COLORS as OWN_COLORS
from .curves import bars as bars
from .curves import convergence as convergence
from .curves import law as law
from .curves import rates as rates
from .curves import rounding_errors as rounding_errors
from .curves import time_to_error as time_to_error
from .figures import LINE_COLORS as LINE_COLORS
from .figures import LINE_MARKERS as LINE_MARKERS
from .figures import panels as panels
from .figures import png as png
from .figures import shared_legend as shared_legend
from .images import heat_map as heat_map
from .images import images as images
from .images import normals as normals
from .intervals import histograms as histograms
from .intervals import reliability as reliability
from .intervals import z_scores as z_scores
from .tails import SAMPLE_COUNT_COLORS as SAMPLE_COUNT_COLORS
from .tails import clamp_bias as clamp_bias
from .tails import clamp_mse as clamp_mse
from .tails import clamp_variance as clamp_variance
from .tails import exceedance as exceedance
from .tails import throughput_law as throughput_law
