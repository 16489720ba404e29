"""The whole evaluation by one command: tasks, groups and methods over many trials, and what they
show.
"""
