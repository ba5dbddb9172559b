"""The comparison of trials with CSV and MCAP runs, and every format gives back what it took."""

import trial_speed


def test_every_format_is_in_the_table(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["trial_speed", "--minutes", "0.05", "--paced-s", "0.1"])
    trial_speed.main()
    said = capsys.readouterr()
    for what in ("trial, one sensor", "trial, four sensors", "CSV", "MCAP, raw", "MCAP, JSON"):
        assert f"\n{what}" in said.out
    assert "1200 packets of 28 bytes" in said.out
    assert "reading" in said.err
