"""Times and sizes as people read them."""

import math

import pytest

from imu_rig.cli.words import clock, counted, lasting, losses, size, supply, uncertainty


@pytest.mark.parametrize(
    ("said", "text"),
    [
        (clock(0), "0:00"),
        (clock(59.99), "0:59"),
        (clock(3742.4), "1:02:22"),
        (clock(0.3, 1), "0:00.3"),
        (clock(3599.96, 1), "59:59.9"),
        (size(999), "999 B"),
        (size(999_700), "1.0 MB"),
        (size(4_210_334), "4.2 MB"),
        (lasting(119), "119 s"),
        (lasting(7199), "120 min"),
        (lasting(1e9), "years"),
        (uncertainty(4.0e-4), "± 0.40 ms"),
        (uncertainty(7.2e-3), "± 7.2 ms"),
        (uncertainty(4.21e-5), "± 42 µs"),
        (uncertainty(1.26), "± 1.3 s"),
        (uncertainty(math.inf), "–"),
        (uncertainty(None), "–"),
        (losses(0, 0.0), "0"),
        (losses(120, 0.0293), "120 (2.93 %)"),
        (losses(1, 1e-6), "1 (<0.01 %)"),
        (counted(1, "sample"), "1 sample"),
        (counted(0, "sample"), "0 samples"),
        (supply(4150.0, "mV"), "4.15 V"),
        (supply(4.15, "V"), "4.15 V"),
        (supply(98.0, "%"), "98 %"),
        (supply(math.nan, "V"), "–"),
    ],
)
def test_words(said, text):
    assert said == text
