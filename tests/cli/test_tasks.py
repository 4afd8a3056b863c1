"""Commands by task: each has one heading and an example that it takes, and help shows no more than that."""

import re
import shlex

import pytest

from lfmesh.cli import app, main
from lfmesh.cli.tasks import TASKS

EXAMPLES = {words: example for examples in TASKS.values() for words, example in examples.items()}


def test_every_command_has_one_task_and_the_everyday_ones_are_ten() -> None:
    listed = [words for examples in TASKS.values() for words in examples]
    assert len(listed) == len(set(listed))
    assert {words for words in listed if " " not in words} == {name for name in app if not name.startswith("-")}
    inner = {f"{name} {each}" for name in ("lens", "study") for each in app[name] if not each.startswith("-")}
    assert {words for words in listed if " " in words} == inner
    assert len(next(iter(TASKS.values()))) == 10


@pytest.mark.parametrize("words", EXAMPLES)
def test_help_begins_with_an_example_that_the_command_takes(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    program, *arguments = shlex.split(EXAMPLES[words].split(">")[0])
    assert program == "lfmesh"
    assert " ".join(arguments).startswith(words)
    app.parse_args(arguments, exit_on_error=False, print_error=False)
    assert main([*words.split(), "--help"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert out.startswith(f"Example: {EXAMPLES[words]} Usage: lfmesh {words}")
    assert "--empty-" not in out
    assert "lfmesh demo" not in out.split("Usage: ")[1].removeprefix("lfmesh demo"), "examples of other commands"


INVERTED = r"\bwhat\b|\bof which\b|\bthose (?:that|of|which|from|in)\b"
"""Signs of a clause in place of a noun."""


@pytest.mark.parametrize("words", EXAMPLES)
def test_help_names_things_by_nouns(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words.split(), "--help"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    places = [out[max(0, hit.start() - 30) : hit.end() + 30] for hit in re.finditer(INVERTED, out, re.IGNORECASE)]
    assert not places


@pytest.mark.parametrize("words", EXAMPLES)
def test_examples_fit_a_terminal_of_80_columns_and_can_be_pasted(
    words: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main([*words.split(), "--help"]) == 0
    out = capsys.readouterr().out
    assert f"Example: {EXAMPLES[words]}\n" in out
    assert max(map(len, out.splitlines())) <= 80
    given = out.split("More examples:")[1] if "More examples:" in out else ""
    for line in re.sub(r"\\\n\s+", "", given).splitlines():
        if command := re.split(r" {2,}", line.strip())[0]:
            program, *arguments = shlex.split(command)
            assert program == "lfmesh"
            app.parse_args(arguments, exit_on_error=False, print_error=False)


def test_the_list_of_commands_goes_by_task(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    headings = [*TASKS, "Options"]
    places = [out.index(f"─ {heading} ─") for heading in headings]
    assert places == sorted(places)
    everyday = out[places[0] : places[1]]
    assert [line.split()[1] for line in everyday.splitlines() if line[:1] == "│" and line[2] != " "] == list(
        TASKS["Everyday"]
    )
