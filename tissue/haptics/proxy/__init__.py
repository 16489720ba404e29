"""Proxy (god-object) of a tool in contact, and virtual coupling of tool and device."""
