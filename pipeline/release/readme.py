"""The text of a dataset's README.md, a pure function of its numbers and of the release."""

from __future__ import annotations

from collections.abc import Sequence

from labyrinth_core.data.columns import COLUMNS
from labyrinth_core.data.labyrinth_table import TABLE, TABLE_COLUMNS, table_config
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.language.text import dump
from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Task
from pipeline.inspection.statistics import DatasetStatistics
from pipeline.machinery import front_matter
from pipeline.machinery.markdown import count, table
from pipeline.release.citation import paper_bibtex, software_bibtex
from pipeline.release.figures import FIGURES
from pipeline.release.limits import limits
from pipeline.release.provenance import (
    ARXIV,
    PAPER_TITLE,
    PAPER_URL,
    PAPER_VENUE,
    Release,
    code,
    command,
)
from pipeline.release.uniqueness import uniqueness

PICTURES = "pictures"
BANNER = f"{PICTURES}/labyrinth.png"


def picture_path(config: str, figure: str) -> str:
    """Return where a picture of a config lies in the dataset's folder."""
    return f"{PICTURES}/{config}-{figure}.png"


def text(datasets: Sequence[DatasetStatistics], default: str, release: Release) -> str:
    """Return the generated text of the card.

    Args:
        datasets: The statistics of each config, the smallest first.
        default: The name of the config that is loaded when none is named.
        release: What is known of the release.
    """
    sections = [
        _introduction(datasets, default, release),
        _loading(datasets, default, release),
        _contents(datasets),
        _labyrinths(datasets, default, release),
        _making(datasets),
        uniqueness(datasets),
        _statistics(datasets, default),
        _language(datasets),
        "\n".join(["## Limits and biases\n", *(f"- {point}" for point in limits(datasets))]),
        _ending(release),
    ]
    return "\n\n".join(filter(None, sections))


def _introduction(datasets: Sequence[DatasetStatistics], default: str, release: Release) -> str:
    names = ", ".join(f"`{dataset.name}`" for dataset in datasets)
    rows = sum(dataset.rows for dataset in datasets)
    named = f"{names}; `{default}` is the default" if len(datasets) > 1 else names
    report = (
        ""
        if release.space is None
        else "\n- **To look at:** [the report](https://huggingface.co/spaces/"
        f"{release.space}) shows labyrinths, episodes and statistics."
    )
    return f"""# Labyrinth

![A labyrinth of train, of validation and of test, each with a way from start to goal]({BANNER})

Pictures of grid labyrinths with the actions that solve them, for imitation learning that can tell
memorising from generalising: an agent learns on the structures of `train` and is judged on those
of `test`, and no structure is in both, not even as a mirror image.

- **{rows:,} rows** in {count(len(datasets), "config")}: {named}.
- **Counted, not assumed:** [which structures two splits share](#no-structure-in-two-splits): none.
- **Self-sufficient rows:** `info` holds the labyrinth as a text that loads it again.{report}

The benchmark is that of *{PAPER_TITLE}*
(Gavenski and Rodrigues, {PAPER_VENUE}, [arXiv:{ARXIV}]({PAPER_URL})).
The data are made anew by the software *Labyrinth datasets*; they are not the authors' files."""


def _loading(datasets: Sequence[DatasetStatistics], default: str, release: Release) -> str:
    name = release.name
    revision = f', revision="{release.version}"' if release.version else ""
    shard = next(d for d in datasets if d.name == default).manifest.of("train")[0]
    hint = (
        ""
        if release.repo_id
        else f"\n`{name}` stands for the id on the Hub; the path of a folder does as well.\n"
    )
    return f"""## Load it
{hint}
With [datasets](https://huggingface.co/docs/datasets):

```python
from datasets import load_dataset

dataset = load_dataset("{name}", "{default}"{revision})
row = dataset["train"][0]
row["obs"], row["actions"], row["rewards"]  # a picture, 0 to 3, a number
```

With the loader of *Labyrinth datasets*, as transitions (s, a, s') that never cross the end of an
episode:

```python
from labyrinth_core import load_transitions

transitions = load_transitions("{name}", "{default}", split="train", image_size=64{revision})
observation, action, next_observation = transitions[0]
```

With nothing but pyarrow and Pillow, from a file:

```python
import io

import pyarrow.parquet as pq
from huggingface_hub import hf_hub_download
from PIL import Image

path = hf_hub_download(
    "{name}", "{default}/{shard.path}", repo_type="dataset"{revision}
)
table = pq.read_table(path)
picture = Image.open(io.BytesIO(table["obs"][0].as_py()["bytes"]))
actions = table["actions"].to_numpy()
```"""


def _contents(datasets: Sequence[DatasetStatistics]) -> str:
    columns = table(("column", "meaning"), ((f"`{c.name}`", c.meaning) for c in COLUMNS), "ll")
    names = front_matter.splits_of([dataset.manifest for dataset in datasets])
    meanings = ((f"`{name}`", SPLITS[name].meaning) for name in names)
    splits = table(("split", "holds"), meanings, "ll")
    rows = [
        (
            f"`{name}`",
            *(f"{of.splits[name].rows:,}" if name in of.splits else "" for of in datasets),
        )
        for name in names
    ]
    megabytes = (sum(shard.bytes for shard in of.manifest.shards) / 1e6 for of in datasets)
    rows += [
        ("all rows", *(f"{dataset.rows:,}" for dataset in datasets)),
        ("MB", *(f"{size:.2f}" for size in megabytes)),
    ]
    counts = table(("split", *(f"`{dataset.name}`" for dataset in datasets)), rows)
    return f"""## What is in it

{columns}

The last state of an episode is a row too, with `actions` -1 and `rewards` 0, so that the rewards
of an episode add up to its return. A step costs `0.1 / (width * height)`, also one into a wall;
the step onto the goal pays 1.

{splits}

Rows in each split:

{counts}"""


def _labyrinths(datasets: Sequence[DatasetStatistics], default: str, release: Release) -> str:
    """Return the section on the tables of labyrinths, empty if a dataset has none."""
    names = [d.name for d in datasets if d.manifest.labyrinths is not None]
    if not names:
        return ""
    shown = default if default in names else names[0]
    revision = f"@{release.version}" if release.version else ""
    columns = table(
        ("column", "meaning"), ((f"`{c.name}`", c.meaning) for c in TABLE_COLUMNS), "ll"
    )
    return f"""## The table of labyrinths

`{TABLE}` in each config's folder has one row for each labyrinth of every split, in the order of
their rows. It is a config of its own: {", ".join(f"`{table_config(name)}`" for name in names)}.

{columns}

DuckDB, polars and pandas read it without downloading the rest, as does any reader of Parquet:

```sql
select split, count(*), avg(turns)
from 'hf://datasets/{release.name}{revision}/{shown}/{TABLE}'
where moves >= 12
group by split
```"""


def _making(datasets: Sequence[DatasetStatistics]) -> str:
    commands = "\n".join(command(dataset.manifest.config) for dataset in datasets)
    made = table(
        ("config", "made with", "fingerprint of values and pixels"),
        (
            (
                f"`{dataset.name}`",
                ", ".join(f"{name} {v}" for name, v in dataset.manifest.versions.items()),
                f"`{dataset.manifest.fingerprint}`",
            )
            for dataset in datasets
        ),
        "lll",
    )
    return f"""## How it was made

```sh
{commands}
```

Structures are sampled without repetition, solved by search, and drawn in every state that an
episode visits. The same command gives the same rows, with any number of workers. `manifest.json`
in each config's folder holds these options, the versions and a SHA-256 of each file;
`labyrinth-datasets stages=[validate]` with the same options replays every row and compares it with
its picture; `sha256sum -c SHA256SUMS` checks the files.

{made}

This card was written by {code()}."""


def _statistics(datasets: Sequence[DatasetStatistics], default: str) -> str:
    pieces = ""
    if any(dataset.manifest.config.pieces for dataset in datasets):
        pieces = (
            "\n\nWith `demonstrations.pieces` an episode of any split but `random` is a piece of a "
            "route: *moves*, *longest* and *return* are of pieces, most of which end before the "
            "goal because they are cut there, and not because an agent failed."
        )
    parts = [
        f"""## Statistics

*Loops* is how many passages a structure has beyond those of a tree (passages - cells + 1), on
average; *moves* and *return* are means over episodes. *Optimal* is the share of the actions that
begin a shortest route; *choices* is how many actions do, in a state that is acted in.{pieces}"""
    ]
    for dataset in sorted(datasets, key=lambda dataset: dataset.name != default):
        section = f"{_numbers(dataset)}\n\n{_pictures(dataset)}"
        if dataset.name == default or len(datasets) == 1:
            parts.append(f"### {dataset.name}\n\n{section}")
        else:
            summary = f"<summary><b>{dataset.name}</b></summary>"
            parts.append(f"<details>\n{summary}\n\n{section}\n\n</details>")
    return "\n\n".join(parts)


def _numbers(dataset: DatasetStatistics) -> str:
    episodes = table(
        ("split", "labyrinths", "loops", "episodes", "rows", "moves", "longest", "return"),
        (
            (
                f"`{name}`",
                f"{split.labyrinths:,}",
                f"{split.mean_loops:.2f}",
                f"{split.episodes:,}",
                f"{split.rows:,}",
                f"{split.mean_moves:.2f}",
                f"{split.longest:,}",
                f"{split.mean_return:.3f}",
            )
            for name, split in dataset.splits.items()
        ),
    )
    actions = table(
        ("split", *(action.name.lower() for action in Action), "optimal", "choices"),
        (
            (
                f"`{name}`",
                *(f"{share:.1%}" for share in split.action_shares),
                f"{split.optimal_share:.1%}",
                f"{split.mean_choices:.2f}",
            )
            for name, split in dataset.splits.items()
        ),
    )
    return f"{episodes}\n\n{actions}"


def _pictures(dataset: DatasetStatistics) -> str:
    shown = "\n\n".join(
        f"**{figure.title}.** {figure.caption}\n\n"
        f"![{figure.title} of {dataset.name}]({picture_path(dataset.name, name)})"
        for name, figure in FIGURES.items()
    )
    if dataset.manifest.config.task is Task.PARTIAL_OBSERVABILITY:
        return f"The labyrinths are shown here without what hides them in `obs`.\n\n{shown}"
    return shown


def _language(datasets: Sequence[DatasetStatistics]) -> str:
    smallest = datasets[0]
    return f"""## The text language

`info` holds the labyrinth in the configuration language of the paper's supplement. This is the
first of `test` in `{smallest.name}`:

```
{dump(smallest.splits["test"].examples[0].labyrinth).strip()}
```

The top line is the highest row. Cells and walls alternate: `|` and `-` are walls, a blank is an
open passage, `+` the point between four cells; `S` is the start, `E` the goal, `K` a key, `D` a
door, `I` ice. The three settings switch a task on. `labyrinth_core.parse` reads it,
`labyrinth check FILE` explains what is wrong with one, and `docs/language.md` of the software has
the grammar; the [paper]({PAPER_URL}) introduces it."""


def _ending(release: Release) -> str:
    licence = (
        "[MIT](https://opensource.org/license/mit)."
        if release.licence == front_matter.LICENCE
        else f"`{release.licence}`, as the head of this file says."
    )
    return f"""## Licence

{licence}

## Citation

```bibtex
{paper_bibtex()}

{software_bibtex()}
```"""
