"""Wire protocols: bytes to integer values and back, nothing else.

Every byte that a device sends or receives is described here and only here. The modules hold no
ports, no clocks and no state of a device, and import nothing but numpy and the standard library.

- :mod:`~firmware_protocols.layout` packet layouts as data, read from TOML files
- :mod:`~firmware_protocols.decoder` a byte stream to packets and loss statistics
- :mod:`~firmware_protocols.packets` packets to counts and values, and back to bytes
- :mod:`~firmware_protocols.maestro` commands, replies and errors of Pololu Maestro controllers
- :mod:`~firmware_protocols.checksums` every checksum that a layout may name
"""
