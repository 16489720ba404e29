"""Objects of `import tissue`, which users create, run and show.

No lower layer imports this package.
"""
