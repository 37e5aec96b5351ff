"""jaxmc: differentiable Monte Carlo integration of light transport.

A light path is one point of a flat integral over the unit hypercube. The same few functions estimate it, say how sure
they are, show which samples are fireflies and price the bias that clamping adds.
"""

from . import backend

backend.configure()

from . import analysis as analysis  # noqa: E402
from .integration.draw import draw as draw  # noqa: E402
from .integration.driver import integrate as integrate  # noqa: E402
from .integration.driver import integrate_each as integrate_each  # noqa: E402
from .integration.estimate import Estimate as Estimate  # noqa: E402
from .integration.integrand import Integrand as Integrand  # noqa: E402
from .integration.moments import Moments as Moments  # noqa: E402
from .integration.samplers import Independent as Independent  # noqa: E402
from .integration.tallies import ClampLadder as ClampLadder  # noqa: E402
from .integration.tallies import Histogram as Histogram  # noqa: E402
from .integration.tallies import TailHistogram as TailHistogram  # noqa: E402
from .integration.tallies import TopSamples as TopSamples  # noqa: E402
from .transport.camera import PinholeCamera as PinholeCamera  # noqa: E402
from .transport.debug import replay as replay  # noqa: E402
from .transport.integrands import intersect as intersect  # noqa: E402
from .transport.integrands import irradiance as irradiance  # noqa: E402
from .transport.integrands import path_integrand as path_integrand  # noqa: E402
from .transport.integrands import path_throughput as path_throughput  # noqa: E402
from .transport.integrands import radiance as radiance  # noqa: E402
from .transport.integrands import render as render  # noqa: E402
from .transport.materials import Diffuse as Diffuse  # noqa: E402
from .transport.materials import Mirror as Mirror  # noqa: E402
from .transport.materials import luminance as luminance  # noqa: E402
from .transport.paths import clamp_luminance as clamp_luminance  # noqa: E402
from .transport.primitives import Quad as Quad  # noqa: E402
from .transport.primitives import Sphere as Sphere  # noqa: E402
from .transport.scene import Scene as Scene  # noqa: E402

__version__ = "0.1.0"
