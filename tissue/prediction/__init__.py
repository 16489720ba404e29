"""Force and state some milliseconds ahead: lifted linear operators, and the simple predictors they have to beat."""

from tissue.prediction.predictor import Hold, Predictor

__all__ = ["Hold", "Predictor"]
