"""`imu-rig demo`: the whole story on simulated hardware in under a minute."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from imu_rig.cli.options import DEFAULT_METHOD, Json, Output, Quiet


def demo(
    seed: Annotated[int, typer.Option(help="Which simulated sensor and jig.")] = 1,
    speed: Annotated[float, typer.Option(help="How much faster than life.")] = 8.0,
    output: Output = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Calibrate a simulated sensor on a simulated jig and compare with the truth."""
    from firmware_protocols.layout import load_layout
    from imu_rig.calibration.gravity import Gravity
    from imu_rig.cli import sessions
    from imu_rig.cli.simulated import simulated_session
    from imu_rig.devices.jig import load_jig
    from imu_rig.session.protocol import DEFAULT_PROTOCOL, load_protocol
    from imu_rig.session.run import SessionSetup

    setup = SessionSetup(
        imu_url="",
        maestro_url="",
        layout=load_layout("mpu9150-28"),
        jig=load_jig("paper-jig"),
        protocol=load_protocol(DEFAULT_PROTOCOL),
        device="simulated MPU-9150",
        serial=f"seed {seed}",
    )
    plan = setup.plan()
    with simulated_session(setup, seed=seed, speed=speed) as simulated:
        folder = sessions.new_folder(output)
        trial = folder / sessions.TRIAL_NAME
        if not quiet:
            sys.stderr.write(
                f"A simulated jig steps a simulated MPU-9150 through {len(plan.steps)} poses, "
                f"over real serial ports and {speed:g} times as fast as life "
                f"({plan.duration_s:.0f} s of jig time).\n"
            )
        gravity = Gravity.given(simulated.rig.truth.gravity)
        sessions.run_in_view(
            simulated.setup,
            trial,
            simulated.clock,
            resume=False,
            quiet=quiet,
            ports=f"--simulate --seed {seed}",
            watch=simulated.observe,
        )
        truth = simulated.truth()
    sessions.finish(
        trial, folder, method=DEFAULT_METHOD, gravity=gravity, as_json=as_json, truth=truth
    )
