"""Every file under tests/data is a case; add a file to add one.

`valid/NAME.labyrinth` has to give `valid/NAME.canonical` when dumped, and `invalid/NAME.labyrinth`
the message in `invalid/NAME.error`.
"""

import re
from pathlib import Path

import pytest

from labyrinth_core.language import SETTINGS_OF, LabyrinthSyntaxError, dump, load, parse
from labyrinth_core.world import TILES

DATA = Path(__file__).parents[2] / "data"
DOCUMENTATION = (DATA.parent.parent / "docs" / "language.md").read_text(encoding="utf-8")
VALID = sorted(DATA.glob("valid/*.labyrinth"))
INVALID = sorted(DATA.glob("invalid/*.labyrinth"))


def name(path: Path) -> str:
    return path.stem


def expected(path: Path) -> str:
    """Return the message in a file, with the settings and the letters that there are filled in."""
    lines = "".join(SETTINGS_OF.values()).splitlines()
    settings = ", ".join(dict.fromkeys(line.partition(":")[0] for line in lines))
    message = path.read_text(encoding="utf-8").replace("{settings}", settings)
    return message.replace("{letters}", ", ".join(tile.letter for tile in TILES))


@pytest.mark.parametrize("path", VALID, ids=name)
def test_a_valid_file_has_this_canonical_text(path):
    labyrinth = load(path)
    canonical = path.with_suffix(".canonical").read_text(encoding="utf-8")
    assert dump(labyrinth) == canonical
    assert parse(canonical) == labyrinth


@pytest.mark.parametrize("path", INVALID, ids=name)
def test_an_invalid_file_has_this_message(path):
    with pytest.raises(LabyrinthSyntaxError) as caught:
        load(path)
    message = str(caught.value).replace(str(path), path.name)
    assert f"{message}\n" == expected(path.with_suffix(".error"))


def test_each_expectation_belongs_to_a_case():
    expectations = [*DATA.glob("valid/*.canonical"), *DATA.glob("invalid/*.error")]
    assert len(VALID) >= 15
    assert len(INVALID) >= 40
    assert {path.with_suffix(".labyrinth") for path in expectations} == {*VALID, *INVALID}


def test_the_messages_in_the_documentation_are_those_of_the_cases():
    shown = re.findall(r"```\n(\w+)\.labyrinth:(.*?)```\n", DOCUMENTATION, re.DOTALL)
    assert shown
    for case, message in shown:
        assert f"{case}.labyrinth:{message}" == expected(DATA / "invalid" / f"{case}.error")


def test_the_example_in_the_documentation_is_the_first_figure():
    example = '"""' + DOCUMENTATION.split('```\n"""', 1)[1].split("```", 1)[0]
    figure = load(DATA / "valid" / "figure_1a_navigation.labyrinth")
    assert parse(example) == figure
