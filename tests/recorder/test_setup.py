"""Setup files of recordings: what is accepted, and the sentence for what is not."""

import pytest

from imu_rig.errors import InputError
from imu_rig.recorder.setup import MAX_SETUP_BYTES, load_setup

GOOD = """
subject = "S01"
duration_s = 60

[[devices]]
name = "left shoe"
port = "usb:FT123"
layout = "own.toml"
certificate = "left.json"

[[devices]]
name = "waist"
port = "socket://192.168.4.1:3000"
required = false

[jig]
maestro = "/dev/ttyACM0"
"""


def written(tmp_path, text):
    path = tmp_path / "setup.toml"
    path.write_text(text)
    return path


def test_files_that_a_setup_names_stand_beside_it(tmp_path):
    setup = load_setup(written(tmp_path, GOOD))
    left, waist = setup.devices
    assert left.layout == str(tmp_path / "own.toml")
    assert left.certificate == tmp_path / "left.json"
    assert left.required
    assert waist.layout == "mpu9150-28"
    assert not waist.required
    assert setup.jig.file == "paper-jig"
    assert setup.duration_s == 60


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("duration = 5", "duration is not a field of a recording setup"),
        ("duration_s = -5", "duration_s"),
        ("duration_s = inf", "duration_s"),
        ("[[devices]]\nname = 'a'", r"devices\.1\.port is missing"),
        ("[[devices]]\nname = 'jig'\nport = 'x'", "kept for the jig"),
        ("[[devices]]\nname = 'a'\nport = \"/dev/x\\u0007\"\n", "control characters"),
        (
            "[[devices]]\nname='a'\nport='x'\n[[devices]]\nname='a'\nport='y'",
            "two devices have the name 'a'",
        ),
        (
            "[[devices]]\nname='a'\nport='x'\n[[devices]]\nname='a/foot'\nport='y'",
            "'a/foot' reads like a stream of 'a'",
        ),
        (
            "[[devices]]\nname='a'\nport='x'\n[[devices]]\nname='b'\nport='x'",
            "port x is there twice",
        ),
        ("[[devices]]\nname='a'\nport='x'\n[jig]\nmaestro='x'", "port x is there twice"),
        ("not toml", "not a TOML file"),
        ("#" * (MAX_SETUP_BYTES + 1), "too large"),
    ],
)
def test_a_setup_that_cannot_be_used_is_refused_in_one_sentence(tmp_path, text, said):
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=said) as caught:
        load_setup(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_layout_that_is_not_there_names_the_device(tmp_path):
    setup = load_setup(written(tmp_path, GOOD))
    with pytest.raises(InputError, match=r"Device 'left shoe': .*no such layout file"):
        setup.devices[0].protocol()
