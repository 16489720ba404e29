"""Train a scene's predictors on runs by simulated hands, and measure them on runs they have not
seen.
"""
