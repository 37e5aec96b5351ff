"""What every cure of fireflies costs: ``compare`` measures them side by side on a scene of yours."""

from .comparison import Comparison as Comparison
from .comparison import Row as Row
from .comparison import compare as compare
from .cures import Cure as Cure
from .cures import Kept as Kept
from .cures import average as average
from .cures import blur_cures as blur_cures
from .cures import path_cures as path_cures
from .cures import plain_cures as plain_cures
from .cures import standard_cures as standard_cures
from .measuring import Best as Best
from .measuring import Measured as Measured
from .measuring import best_clamp as best_clamp
from .measuring import from_averages as from_averages
from .measuring import from_images as from_images
from .merging import merged as merged
