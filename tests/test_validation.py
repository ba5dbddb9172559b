"""Sentences about files that nobody vouches for: short, and harmless on a terminal."""

import pytest
from pydantic import BaseModel, ConfigDict, ValidationError

from imu_rig.errors import InputError
from imu_rig.files import parse_toml
from imu_rig.session.protocol import JigProtocol
from imu_rig.validation import sentence

ESCAPE = "\x1b[2J\n\u202e"


class File(BaseModel):
    model_config = ConfigDict(extra="forbid")

    rate: float = 1.0


@pytest.mark.parametrize(
    "content",
    [
        {ESCAPE: 1},
        {"x" * 300_000: 1},
        {"rate": ESCAPE},
        {"rate": "x" * 300_000},
        {f"{ESCAPE}{i}": "x" * 10_000 for i in range(100)},
    ],
)
def test_a_sentence_is_short_and_printable_whatever_the_file_holds(content):
    with pytest.raises(ValidationError) as caught:
        File.model_validate(content)
    said = sentence(caught.value, "a file")
    assert said.isprintable()
    assert len(said) < 1000


def test_texts_of_a_protocol_are_one_printable_line():
    mounting = {"name": f"a{ESCAPE}b", "instruction": f"turn it{ESCAPE}over"}
    step = {"pan": 0, "name": f"s{ESCAPE}"}
    protocol = JigProtocol.model_validate(
        {"name": f"p{ESCAPE}", "title": f"t{ESCAPE}", "steps": [step], "mountings": [mounting]}
    )
    described = protocol.mountings[0]
    texts = (protocol.name, protocol.title, protocol.steps[0].name)
    for text in (*texts, described.name, described.instruction):
        assert text
        assert text.isprintable()


def test_broken_toml_is_quoted_shortly():
    with pytest.raises(InputError) as caught:
        parse_toml(f"[{'a' * 50_000}]\n[{'a' * 50_000}]".encode(), "a.toml")
    assert len(str(caught.value)) < 400
