"""Between a hand and a tissue: devices, hands, what keeps their loop stable, how a contact
becomes a force.
"""
