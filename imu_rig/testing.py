"""What a test of a program needs: recordings that stand in for the hardware."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from imu_rig.clock import Clock
from imu_rig.recording.reader import Trial, open_trial
from imu_rig.recording.replay import RecordedWires
from simulators.replay import FAST, Replay

__all__ = ["FAST", "Replay", "replay_of", "replayed"]


@contextmanager
def replayed(
    trial: Trial | Path | str,
    sources: Sequence[str] = (),
    *,
    speed: float = 1.0,
    clock: Clock | None = None,
    transport: Literal["pty", "tcp"] = "pty",
    wait: bool = True,
    loop: bool = False,
    unplug_in_gaps: bool = False,
) -> Iterator[Replay]:
    """Put the devices of a trial on real ports while the block runs.

    Parameters
    ----------
    trial : Trial or path
    sources : sequence of str
        Which; all by default.
    speed : float
        Times as fast as recorded, or ``FAST``: as fast as the clients read.
    clock : Clock, optional
        A `SteppedClock` plays only when told: ``replay.step(seconds)``.
    transport, wait, loop, unplug_in_gaps
        See `simulators.replay.Replay`.

    Yields
    ------
    Replay
        ``url(name)`` is what a program opens, ``received(name)`` what it wrote.

    Raises
    ------
    InputError
        If the trial cannot be read or holds nothing to replay.
    """
    opened = trial if isinstance(trial, Trial) else open_trial(trial)
    with replay_of(
        RecordedWires(opened, sources),
        speed=speed,
        clock=clock,
        transport=transport,
        wait=wait,
        loop=loop,
        unplug_in_gaps=unplug_in_gaps,
    ) as replay:
        yield replay


def replay_of(
    wires: RecordedWires,
    *,
    speed: float = 1.0,
    clock: Clock | None = None,
    transport: Literal["pty", "tcp"] = "pty",
    wait: bool = True,
    loop: bool = False,
    unplug_in_gaps: bool = False,
    folder: Path | None = None,
) -> Replay:
    """Make a replay, not yet started, of what a trial's wires carried; see `Replay`."""
    return Replay(
        [source.name for source in wires.sources],
        wires,
        clock=clock,
        speed=speed,
        transport=transport,
        answers={name: wires.exchanges(name) for name in wires.answering},
        wait=wait,
        loop=loop,
        unplug_in_gaps=unplug_in_gaps,
        folder=folder,
    )
