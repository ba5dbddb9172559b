"""The table of exports has a line for every format."""

import export_speed


def test_every_format_is_in_the_table(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["export_speed", "--minutes", "0.02"])
    monkeypatch.setattr(export_speed, "FORMATS", {"mat": export_speed.FORMATS["mat"]})
    export_speed.main()
    words = capsys.readouterr().out.split()
    assert words[:2] == ["480", "samples"]
    assert words[words.index("mat") + 1 :][0] != "0.0"
