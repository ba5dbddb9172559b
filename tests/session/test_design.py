"""Designed protocols: inside limits, reach and time, as good as promised, the same every time."""

import numpy as np
import pytest
from hypothesis import Phase, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from imu_rig.calibration.expected import expected_sensors
from imu_rig.devices.jig import JigConfig, load_jig
from imu_rig.errors import InputError
from imu_rig.files import parse_toml
from imu_rig.session.design import Task, design_protocol, structured
from imu_rig.session.observability import design_of
from imu_rig.session.plan import plan_session
from imu_rig.session.protocol import AXIS_NAMES, load_protocol
from imu_rig.session.protocol_text import protocol_text

JIG = load_jig("paper-jig")


def with_limits(**limits: tuple[float, float]) -> JigConfig:
    axes = {
        axis: getattr(JIG, axis).model_copy(update={"limits_deg": limits[axis]}) for axis in limits
    }
    return JIG.model_copy(update=axes)


def angles_of(plan) -> np.ndarray:
    return np.array([[getattr(step.pose, axis) for axis in AXIS_NAMES] for step in plan.steps])


def test_the_structured_list_is_the_default_protocol() -> None:
    stops = structured(Task.on(JIG, 120.0), 8, 2)
    full = plan_session(load_protocol("full"), JIG)
    fitted = [step for step in full.steps if step.kind != "check"]
    assert [stop.angles for stop in stops] == [
        (step.pose.pan, step.pose.tilt, step.pose.roll) for step in fitted
    ]


@hypothesis_settings(max_examples=3, phases=(Phase.explicit, Phase.generate))
@given(
    tilt=st.floats(50, 96),
    roll=st.floats(60, 190),
    pan=st.floats(5, 180),
    seconds=st.floats(60, 100),
    mountings=st.sampled_from((1, 2)),
)
def test_designs_obey_jig_reach_and_time(
    tilt: float, roll: float, pan: float, seconds: float, mountings: int
) -> None:
    jig = with_limits(tilt=(-70.0, 90.0), pan=(-180.0, 180.0))
    task = Task.on(
        jig,
        seconds,
        reach={"tilt": tilt, "roll": roll, "pan": pan},
        mountings=mountings,
    )
    found = design_protocol(task, search=2)
    assert found.plan.duration_s <= seconds
    angles = np.abs(angles_of(found.plan))
    assert np.all(angles <= np.array([pan, min(tilt, 90.0), roll]) + 0.05)
    assert np.all(angles_of(found.plan)[:, 1] >= -70.0)
    assert len({step.mounting for step in found.plan.steps}) == mountings


def test_a_search_never_makes_it_worse_and_gives_the_same_again() -> None:
    task = Task.on(JIG, 50.0, name="mine")
    plain, first, again = (design_protocol(task, search=n) for n in (0, 25, 25))
    assert first.score <= plain.score
    assert first.protocol == again.protocol


def test_more_time_is_used_and_pays() -> None:
    scores = [design_protocol(Task.on(JIG, t), search=0).score for t in (50.0, 70.0, 100.0)]
    assert scores == sorted(scores, reverse=True)
    assert scores[2] < 0.6 * scores[0]


def test_a_short_reach_is_proposed_a_second_mounting() -> None:
    found = design_protocol(Task.on(JIG, 70.0, reach={"tilt": 45, "roll": 45}), search=0)
    assert found.turned_over is not None
    assert found.turned_over < found.score / 3
    assert design_protocol(Task.on(JIG, 55.0), search=0).turned_over is None


def test_gyro_only_is_judged_by_the_gyroscope() -> None:
    task = Task.on(JIG, 55.0, gyro_only=True)
    only = design_protocol(task, search=40)
    both = design_protocol(Task.on(JIG, 55.0), search=0)

    def cross(plan) -> float:
        K = expected_sensors(design_of(plan, JIG))[1].K_uncertainty
        return float(np.max(K[~np.eye(3, dtype=bool)]))

    assert cross(only.plan) <= cross(both.plan)


def test_too_little_time_says_how_much() -> None:
    with pytest.raises(InputError) as caught:
        design_protocol(Task.on(JIG, 10.0))
    words = str(caught.value)
    assert "too short" in words
    enough = float(words.split("allow ")[1].split(" s")[0])
    assert design_protocol(Task.on(JIG, enough), search=0).plan.duration_s <= enough


def test_a_reach_that_shows_nothing_is_refused_with_what_to_add() -> None:
    with pytest.raises(InputError, match="larger reach"):
        design_protocol(Task.on(with_limits(tilt=(-5, 5), roll=(-5, 5)), 100.0))
    with pytest.raises(InputError, match="nothing within a reach"):
        Task.on(with_limits(tilt=(30.0, 60.0)), 100.0, reach={"tilt": 20.0})


def test_the_advice_lies_within_what_was_asked_for() -> None:
    reach = {"tilt": 20.0, "roll": 20.0}
    with pytest.raises(InputError) as caught:
        design_protocol(Task.on(JIG, 70.0, reach=reach), search=0)
    assert "larger reach, or take --mountings 2" in str(caught.value)
    assert "add poses" not in str(caught.value)
    found = design_protocol(Task.on(JIG, 70.0, reach=reach, mountings=2), search=0)
    (warning,) = [w for w in found.outlook.warnings if "too little of some axis" in w]
    assert "mounting" not in warning
    assert "add poses" not in warning
    narrow = design_protocol(Task.on(JIG, 70.0, reach={"tilt": 20.0}), search=0)
    assert not any("tilt -" in w or "mounting" in w for w in narrow.outlook.warnings)


@pytest.mark.parametrize("mountings", [1, 2])
def test_the_written_file_says_the_same(tmp_path, mountings: int) -> None:
    found = design_protocol(Task.on(JIG, 60.0, mountings=mountings, name="mine"), search=3)
    path = tmp_path / "mine.toml"
    path.write_text(protocol_text(found.protocol, ["What for.", " kept   as it is"]))
    assert load_protocol(path) == found.protocol
    assert path.read_text().startswith("# What for.\n#\n#  kept   as it is\n")


@given(st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=60))
def test_any_name_survives_its_file(text: str) -> None:
    protocol = load_protocol("full").model_copy(update={"name": text, "title": text})
    written = protocol_text(protocol, []).encode()
    assert parse_toml(written, "mine")["name"] == text
