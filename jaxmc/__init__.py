"""jaxmc: differentiable Monte Carlo integration of light transport.

A light path is one point of a flat integral over the unit hypercube. The same few functions estimate it, say how sure
they are, show which samples are fireflies and price the bias that clamping adds.
"""

from . import backend

backend.configure()

from . import analysis as analysis
from . import fireflies as fireflies
from .gradients.check import Finding as Finding
from .gradients.check import GradCheck as GradCheck
from .gradients.check import gradcheck as gradcheck
from .gradients.derivative import Gradient as Gradient
from .gradients.derivative import WithBoundary as WithBoundary
from .gradients.derivative import grad_integrate as grad_integrate
from .gradients.estimators import Drawn as Drawn
from .gradients.estimators import ScoreControl as ScoreControl
from .gradients.estimators import attached_integrand as attached_integrand
from .gradients.estimators import blurred as blurred
from .gradients.estimators import difference_integrand as difference_integrand
from .gradients.estimators import score_control as score_control
from .gradients.estimators import score_integrand as score_integrand
from .gradients.fitting import Fit as Fit
from .gradients.fitting import fit as fit
from .gradients.images import render_grad as render_grad
from .gradients.paths import direct_irradiance as direct_irradiance
from .gradients.paths import mean_direct_irradiance as mean_direct_irradiance
from .gradients.paths import mean_moving_irradiance as mean_moving_irradiance
from .gradients.paths import moving_irradiance as moving_irradiance
from .gradients.paths import moving_paths as moving_paths
from .gradients.paths import moving_radiance as moving_radiance
from .integration.adaptive import ImportanceMap as ImportanceMap
from .integration.adaptive import adapt as adapt
from .integration.buckets import Buckets as Buckets
from .integration.checkpoint import Checkpoint as Checkpoint
from .integration.combine import combine as combine
from .integration.compiled import estimator as estimator
from .integration.controls import control_variates as control_variates
from .integration.covariance import Covariance as Covariance
from .integration.covariance import CovarianceResult as CovarianceResult
from .integration.debias import debias as debias
from .integration.debias import debias_price as debias_price
from .integration.draw import draw as draw
from .integration.driver import integrate as integrate
from .integration.driver import integrate_each as integrate_each
from .integration.estimate import Estimate as Estimate
from .integration.integrand import Integrand as Integrand
from .integration.intervals import Interval as Interval
from .integration.lattices import Lattice as Lattice
from .integration.layers import Cascade as Cascade
from .integration.layers import Layers as Layers
from .integration.machines import join_processes as join_processes
from .integration.merging import merge as merge
from .integration.mixtures import mixture as mixture
from .integration.mixtures import one_sample_mixture as one_sample_mixture
from .integration.mixtures import optimal_mixture as optimal_mixture
from .integration.moments import Moments as Moments
from .integration.nets import Halton as Halton
from .integration.nets import Sobol as Sobol
from .integration.pick_freeze import pick_freeze as pick_freeze
from .integration.pixel_tails import PixelTails as PixelTails
from .integration.samplers import Independent as Independent
from .integration.schedules import integrate_progressively as integrate_progressively
from .integration.spike import Spike as Spike
from .integration.spike import spike as spike
from .integration.stratified import LatinHypercube as LatinHypercube
from .integration.stratified import Stratified as Stratified
from .integration.tallies import ClampLadder as ClampLadder
from .integration.tallies import Histogram as Histogram
from .integration.tallies import TailHistogram as TailHistogram
from .integration.tallies import TopSamples as TopSamples
from .integration.techniques import Technique as Technique
from .live import preview as preview
from .transport.areas import irradiance_by_areas as irradiance_by_areas
from .transport.autopsy import Autopsy as Autopsy
from .transport.autopsy import autopsy as autopsy
from .transport.camera import PinholeCamera as PinholeCamera
from .transport.clamps import Clamp as Clamp
from .transport.clamps import ClampLevels as ClampLevels
from .transport.clamps import Term as Term
from .transport.clamps import clamp_luminance as clamp_luminance
from .transport.debug import replay as replay
from .transport.debug import sample_index as sample_index
from .transport.filters import BoxFilter as BoxFilter
from .transport.filters import GaussianFilter as GaussianFilter
from .transport.filters import MitchellFilter as MitchellFilter
from .transport.filters import TentFilter as TentFilter
from .transport.images import render as render
from .transport.images import render_progressively as render_progressively
from .transport.integrands import irradiance as irradiance
from .transport.integrands import neumann_terms as neumann_terms
from .transport.integrands import path_integrand as path_integrand
from .transport.integrands import path_throughput as path_throughput
from .transport.integrands import radiance as radiance
from .transport.intersection import intersect as intersect
from .transport.materials import Dielectric as Dielectric
from .transport.materials import Diffuse as Diffuse
from .transport.materials import Mirror as Mirror
from .transport.materials import RoughConductor as RoughConductor
from .transport.materials import luminance as luminance
from .transport.occlusion import ambient_occlusion as ambient_occlusion
from .transport.path_parts import part_names as part_names
from .transport.path_parts import path_parts as path_parts
from .transport.primitives import Box as Box
from .transport.primitives import Disk as Disk
from .transport.primitives import Quad as Quad
from .transport.primitives import Sphere as Sphere
from .transport.primitives import Triangle as Triangle
from .transport.regularize import Regularize as Regularize
from .transport.regularize import Shrinking as Shrinking
from .transport.scene import Scene as Scene
from .transport.scene_files import load_scene as load_scene
from .transport.scene_files import save_scene as save_scene
from .transport.sky import GradientSky as GradientSky
from .transport.strategy import PathOptions as PathOptions
from .transport.strategy import Roulette as Roulette
from .transport.tuning import tune_regularization as tune_regularization
from .transport.views import view_bounces as view_bounces
from .transport.views import view_depth as view_depth
from .transport.views import view_fireflies as view_fireflies
from .transport.views import view_normals as view_normals
from .transport.views import view_time as view_time
from .transport.views import view_variance as view_variance

__version__ = "0.1.0"
