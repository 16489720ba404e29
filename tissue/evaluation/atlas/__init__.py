"""The stability atlas: every method taken to where it fails and past it, a page each."""
