"""Live and finished runs in a browser: pictures drawn here, sent to one page on this machine
alone.
"""
