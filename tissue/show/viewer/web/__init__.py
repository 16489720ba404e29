"""Live and finished runs in a browser.

This machine draws the pictures for one page, which is open on the same machine.
"""
