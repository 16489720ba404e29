"""Force and state some milliseconds ahead: lifted linear operators, and the simple predictors
they have to beat.
"""
