"""CT of a person: what an image holds, its labels and their names, and bone out of it with its
density.
"""
