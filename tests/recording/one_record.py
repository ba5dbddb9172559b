"""One record by itself, as no recorder writes it."""

from imu_rig.recording.format import encode_records


def encode_record(seed, kind, source, sequence, time_ns, payload):
    return encode_records(seed, sequence, [(kind, source, time_ns, payload)])
