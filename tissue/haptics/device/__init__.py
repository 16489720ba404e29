"""Haptic devices: their contract, real limits, simulated, recorded and faulty ones, and safe
operation.
"""
