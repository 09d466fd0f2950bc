"""The command `navbake report`."""

import json


def test_a_report_of_two_bakes(folder, run):
    run("bake", "room.yaml", "-q")
    run("bake", "room.yaml", "-o", "other.grid.json", "--set", "agent.radius=0.3", "-q")
    status, out, _ = run(
        "report", "room.grid.json", "other.grid.json", "-o", "report.html", "--audit"
    )
    assert (status, out) == (0, "report.html\n")
    assert b"<title>room, other</title>" in (folder / "report.html").read_bytes()


def test_a_verification_is_added(folder, run):
    run("bake", "room.yaml", "-q")
    _, out, _ = run("verify", "room.grid.json", "--json")
    (folder / "verify.json").write_text(out)
    arguments = ("room.grid.json", "-o", "report.html", "--verify", "verify.json")
    assert run("report", *arguments)[0] == 0
    assert b"Verification: agrees" in (folder / "report.html").read_bytes()
    status, _, err = run("report", "room.grid.json", *arguments)
    assert status == 2
    assert "expected one for each GRID, 2, got 1" in err


def test_outputs_and_inputs_are_checked_first(folder, run):
    run("bake", "room.yaml", "-q")
    status, _, err = run("report", "room.grid.json", "-o", "report.pdf")
    assert status == 2
    assert ".html" in err
    (folder / "verify.json").write_text(json.dumps([]))
    status, _, err = run("report", "room.grid.json", "-o", "report.html", "--verify", "verify.json")
    assert status == 1
    assert "verify.json" in err
    assert not (folder / "report.html").exists()
