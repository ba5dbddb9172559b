"""The trial file: one append-only file per trial that no crash can spoil."""

from imu_rig.recording.contents import ClockPairs, Event, Gap, Marker, Missing, Source, Wire
from imu_rig.recording.format import SUFFIX
from imu_rig.recording.log import RecordingOptions
from imu_rig.recording.reader import Trial, open_trial
from imu_rig.recording.scan import Damage
from imu_rig.recording.writer import TrialWriter

__all__ = [
    "SUFFIX",
    "ClockPairs",
    "Damage",
    "Event",
    "Gap",
    "Marker",
    "Missing",
    "RecordingOptions",
    "Source",
    "Trial",
    "TrialWriter",
    "Wire",
    "open_trial",
]
