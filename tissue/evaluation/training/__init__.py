"""Training of a scene's predictors on runs by simulated hands, and tests on unseen runs."""
