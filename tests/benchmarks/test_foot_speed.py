"""The table of the foot smoother's speed has all of its lines."""

import foot_speed


def test_every_way_is_timed(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["foot_speed", "--repeats", "1"])
    block = foot_speed.long_walk(0.0, metres=6.0)
    monkeypatch.setattr(foot_speed, "long_walk", lambda _: block)
    monkeypatch.setattr(foot_speed, "first_call", lambda *_: (0.0, 0.0))
    monkeypatch.setattr(foot_speed.textbook_rts, "smooth", lambda *_: None)
    foot_speed.main()
    told = capsys.readouterr().out
    for line in ("textbook", "16 states", "13 states", "whole smoother", "with covariance"):
        assert line in told
