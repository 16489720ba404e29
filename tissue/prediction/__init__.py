"""Force and state some milliseconds ahead: lifted linear operators, and the simple predictors they have to beat."""

from tissue.prediction.closure import StepErrors, closure_defects, step_errors
from tissue.prediction.dictionary import Delays, Dictionary, Identity, Together
from tissue.prediction.edmd import Edmd
from tissue.prediction.episodes import Episode
from tissue.prediction.gap_products import GapProducts
from tissue.prediction.lifted import Generator, Operator
from tissue.prediction.online import Online
from tissue.prediction.polynomials import Polynomials
from tissue.prediction.predictor import Hold, Predictor
from tissue.prediction.predictor_file import StoredPredictor, read_predictor, write_predictor
from tissue.prediction.radial import Gaussians, ThinPlates
from tissue.prediction.validation import Choice, HorizonErrors, choose, horizon_errors

__all__ = [
    "Choice",
    "Delays",
    "Dictionary",
    "Edmd",
    "Episode",
    "GapProducts",
    "Gaussians",
    "Generator",
    "Hold",
    "HorizonErrors",
    "Identity",
    "Online",
    "Operator",
    "Polynomials",
    "Predictor",
    "StepErrors",
    "StoredPredictor",
    "ThinPlates",
    "Together",
    "choose",
    "closure_defects",
    "horizon_errors",
    "read_predictor",
    "step_errors",
    "write_predictor",
]
