"""Train a scene's predictors on runs by simulated hands, and measure them on runs they have not seen."""

from tissue.training.evaluation import forecast_errors
from tissue.training.fitting import fit
from tissue.training.recording import Recorder, Recording, trial
from tissue.training.train import train

__all__ = ["Recorder", "Recording", "fit", "forecast_errors", "train", "trial"]
