"""Names that people give devices, as names of files, topics and variables."""

import re

from hypothesis import given
from hypothesis import strategies as st

from imu_rig.calibration.exports.matlab import KEYWORDS
from imu_rig.exporting.names import file_names, variable_names

NAMES = st.lists(st.text(min_size=1, max_size=60), unique=True, max_size=12)


@given(NAMES)
def test_every_device_gets_a_file_name_of_its_own(names: list[str]) -> None:
    found = file_names(names, taken=("gaps", "markers"))
    assert list(found) == names
    words = [word.casefold() for word in found.values()]
    assert len({*words, "gaps", "markers"}) == len(words) + 2
    assert all(re.fullmatch(r"[\w-]{1,45}", word) for word in found.values())


@given(NAMES)
def test_every_device_gets_a_variable_of_its_own(names: list[str]) -> None:
    found = variable_names(names, taken=("trial",))
    words = [word.casefold() for word in found.values()]
    assert len({*words, "trial"}) == len(words) + 1
    assert all(re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,62}", word) for word in found.values())
    assert KEYWORDS.isdisjoint(found.values())


def test_usual_names_stay_readable() -> None:
    assert file_names(["left shoe", "Left/Shoe", "왼발", "..", "gaps"], taken=("gaps",)) == {
        "left shoe": "left_shoe",
        "Left/Shoe": "Left_Shoe_2",
        "왼발": "왼발",
        "..": "device",
        "gaps": "gaps_2",
    }
    assert variable_names(
        ["left shoe", "2nd", "end", "Füße", "왼발", "trial"], taken=("trial",)
    ) == {
        "left shoe": "left_shoe",
        "2nd": "device_2nd",
        "end": "end_",
        "Füße": "Fu_e",
        "왼발": "device",
        "trial": "trial_2",
    }
