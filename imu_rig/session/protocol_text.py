"""A protocol as the text of its file, with comments for the people who read it."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from imu_rig.session.protocol import AXIS_NAMES, JigProtocol, Mounting, Step


def protocol_text(protocol: JigProtocol, comments: Sequence[str]) -> str:
    """Write a protocol as TOML that `load_protocol` reads back.

    Parameters
    ----------
    protocol : JigProtocol
        What the file says.
    comments : sequence of str
        Paragraphs of its header; lines of a paragraph that begins with a blank are kept.
    """
    lines: list[str] = []
    for paragraph in comments:
        kept = paragraph.startswith(" ")
        lines += paragraph.splitlines() if kept else textwrap.wrap(paragraph, 96)
        lines.append("")
    text = [f"# {line}".rstrip() for line in lines[:-1]]
    text += [
        "",
        f"name = {_quoted(protocol.name)}",
        f"title = {_quoted(protocol.title)}",
        f"hold_s = {protocol.hold_s:g}",
        f"settle_s = {protocol.settle_s:g}",
        "",
        "steps = [",
    ]
    for number, step in enumerate(protocol.steps):
        if number and step.roll is not None:
            text.append("")
        text.append(f"  {_step(step)},")
    text.append("]")
    for mounting in protocol.mountings:
        text += ["", "[[mountings]]", *_mounting(mounting)]
    return "\n".join(text) + "\n"


def _step(step: Step) -> str:
    told = [f"{axis} = {getattr(step, axis):g}" for axis in AXIS_NAMES if _given(step, axis)]
    if step.kind != "pose":
        told.append(f'kind = "{step.kind}"')
    if step.hold_s is not None:
        told.append(f"hold_s = {step.hold_s:g}")
    if step.mounting is not None:
        told.append(f"mounting = {step.mounting}")
    if step.name is not None:
        told.append(f"name = {_quoted(step.name)}")
    return f"{{ {', '.join(told)} }}" if told else "{}"


def _given(step: Step, axis: str) -> bool:
    return getattr(step, axis) is not None


def _mounting(mounting: Mounting) -> list[str]:
    lines = [f"name = {_quoted(mounting.name)}"]
    if mounting.instruction:
        lines.append(f"instruction = {_quoted(mounting.instruction)}")
    if mounting.angle_deg:
        lines.append(f"axis = [{', '.join(f'{part:g}' for part in mounting.axis)}]")
        lines.append(f"angle_deg = {mounting.angle_deg:g}")
    return lines


def _quoted(text: str) -> str:
    """Write a TOML basic string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'
