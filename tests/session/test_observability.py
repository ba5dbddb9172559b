"""What is refused before anything moves, and that the reason names the right axis and servo."""

import numpy as np
import pytest

from imu_rig.devices.jig import JigConfig, load_jig
from imu_rig.errors import InputError
from imu_rig.session.observability import Outlook, outlook
from imu_rig.session.plan import plan_session
from imu_rig.session.protocol import JigProtocol, Mounting, Step, builtin_protocols, load_protocol

JIG = load_jig("paper-jig")
CERTIFICATE_ONLY = "check"
FOR_THE_PAPER = "six-faces-and-turns"


def protocol(*poses: tuple[float, float, float], **more: object) -> JigProtocol:
    steps = tuple(Step(pan=p, tilt=t, roll=r) for p, t, r in poses)
    return JigProtocol.model_validate({"name": "mine", "steps": steps, **more})


def told(mine: JigProtocol, method: str = "joint", jig: JigConfig = JIG) -> Outlook:
    return outlook(plan_session(mine, jig), jig, method)


def refusal(mine: JigProtocol, method: str = "joint") -> str:
    with pytest.raises(InputError) as caught:
        told(mine, method)
    assert caught.value.exit_code == 2
    assert "\n" not in str(caught.value)
    return str(caught.value)


RING = [(90 * (i % 2), t, 45 * i - 180) for i in range(8) for t in (0, 60, -60)]


@pytest.mark.parametrize("name", sorted({*builtin_protocols()} - {CERTIFICATE_ONLY, FOR_THE_PAPER}))
def test_every_protocol_that_calibrates_determines_everything(name: str) -> None:
    for method in ("joint", "multi-position", "paper"):
        outlook = told(load_protocol(name), method)
        assert outlook.warnings == ()


@pytest.mark.parametrize("method", ["joint", "multi-position"])
def test_six_faces_determine_six_of_nine(method: str) -> None:
    sentence = refusal(load_protocol(FOR_THE_PAPER), method)
    assert "6 ways" in sentence
    assert "non-orthogonality xy, non-orthogonality xz and non-orthogonality yz" in sentence
    assert "scale" not in sentence
    assert "tilt 45 with roll" in sentence
    assert "--method paper" in sentence


def test_six_faces_are_enough_for_the_paper() -> None:
    outlook = told(load_protocol(FOR_THE_PAPER), "paper")
    assert outlook.expected.gyro is not None


def test_what_is_advised_is_enough() -> None:
    """The poses named in a refusal, added to the protocol, make it acceptable."""
    faces = [(0, 0, 0), (0, 0, 90), (0, 0, 180), (0, 0, -90), (0, 90, 0), (0, -90, 0)]
    sentence = refusal(protocol(*faces))
    advice = sentence.split("add poses at ")[1].split(", take a longer")[0]
    added = []
    for part in advice.split("tilt ")[1:]:
        tilt, rolls = part.split(" with roll ")
        words = rolls.replace(" and ", ", ").split(",")
        added += [(0.0, float(tilt), float(roll)) for roll in words if roll.strip()]
    assert len(added) >= 3
    assert told(protocol(*faces, *added, (90, 0, 0), (90, 0, 170))).expected.gyro is not None


def test_a_check_calibrates_nothing() -> None:
    assert "imu-rig verify" in refusal(load_protocol(CERTIFICATE_ONLY))


def test_a_ring_about_the_roll_axis_leaves_x_open() -> None:
    sentence = refusal(protocol(*[(0, 0, roll) for roll in range(-180, 180, 15)]))
    assert "scale x" in sentence
    assert "scale y" not in sentence


def test_pan_alone_shows_nothing() -> None:
    sentence = refusal(protocol(*[(pan, 0, 0) for pan in range(-180, 180, 15)]))
    assert "1 way in it" in sentence
    assert "everything" in sentence


def steep(*tilts: float) -> list[tuple[float, float, float]]:
    """Poses all around whose roll changes only with the arm upright."""
    return [
        (0, sign * tilt, roll)
        for i, roll in enumerate(range(-180, 180, 45))
        for sign in ((1, -1)[i % 2],)
        for tilt in tilts
    ]


def test_a_roll_that_turns_only_upright_leaves_the_gyroscope_s_x_open() -> None:
    sentence = refusal(protocol(*steep(90, 45, 0, -45, -90)), "multi-position")
    assert "scale x of the gyroscope" in sentence
    assert "scale y" not in sentence
    assert "roll turns only where the arm stands steep" in sentence
    assert "roll at tilt 0 for x" in sentence


def test_the_axis_named_is_the_sensor_s_whatever_way_it_is_mounted() -> None:
    turned = Mounting(name="turned", axis=(0.0, 0.0, 1.0), angle_deg=90.0)
    mine = protocol(*steep(90, 45, 0, -45, -90), mountings=(turned,))
    sentence = refusal(mine, "multi-position")
    # The plate's x is the sensor's -y now.
    assert "scale y of the gyroscope" in sentence
    assert "roll at tilt 0 for y" in sentence


def test_few_poses_are_called_fragile() -> None:
    few = RING[::2]
    assert len(few) == 12
    (warning,) = told(protocol(*few), "multi-position").warnings
    assert "12 poses" in warning
    assert "fragile" in warning


def test_a_short_reach_is_told_with_its_cost_and_its_cure() -> None:
    poses = [
        (90 * (i % 2), tilt, roll)
        for i, roll in enumerate(np.linspace(-45, 45, 5))
        for tilt in np.linspace(-45, 45, 5)
    ]
    (warning,) = told(protocol(*poses)).warnings
    assert "tilt up to 45" in warning
    assert "second mounting" in warning
    times = float(warning.split(" times as")[0].split()[-1])
    assert times > 5


def test_one_pan_angle_is_told() -> None:
    (warning,) = told(protocol(*[(0, t, r) for _, t, r in RING])).warnings
    assert "Pan" in warning
    assert "90 degrees apart" in warning


def test_poses_kept_out_of_the_fit_tell_nothing() -> None:
    mine = load_protocol("full")
    fitted = mine.model_copy(update={"steps": tuple(s for s in mine.steps if s.kind != "check")})
    both = [[g.rms for g in told(p).expected.groups()] for p in (mine, fitted)]
    assert both[0] == pytest.approx(both[1], rel=1e-6)


def test_an_unknown_method_names_the_known_ones() -> None:
    assert "joint" in refusal(protocol(*RING), "guess")


def test_the_table_method_is_not_for_a_jig() -> None:
    assert "imu-rig solve" in refusal(protocol(*RING), "ferraris")
