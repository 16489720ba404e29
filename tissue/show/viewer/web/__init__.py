"""Live and finished runs in a browser: this machine draws pictures for one page on the same
machine.
"""
