"""Wire protocols: bytes to integer values and back, nothing else.

Every byte that a device sends or receives is described here and only here. The modules hold no
ports, no clocks and no state of a device, and import nothing but numpy and the standard library.
"""
