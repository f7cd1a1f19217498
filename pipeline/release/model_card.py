"""The card of a policy, a pure function of its evaluation and of its dataset."""

from __future__ import annotations

from dataclasses import dataclass

from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.evaluation.description import TrainedRun
from labyrinth_core.evaluation.results import Results
from labyrinth_core.policies.spec import MapperSpec, PlannerSpec, PolicySpec
from pipeline.machinery import front_matter
from pipeline.machinery.markdown import count, table
from pipeline.release.citation import paper_bibtex, software_bibtex
from pipeline.release.provenance import ARXIV, code

LIBRARY = "labyrinth-datasets"


@dataclass(frozen=True)
class Trained:
    """A policy that is published, and what is known of it."""

    model: str
    """The id on the Hub, such as `user/planner-5x5`."""
    version: str
    spec: PolicySpec
    weights: int
    """The number of its weights."""
    dataset: str
    """The id on the Hub of the dataset that it was trained on."""
    revision: str
    """The revision of the dataset."""
    manifest: Manifest
    results: Results
    """What it achieves on that dataset."""
    run: TrainedRun
    """The run that made it."""

    @property
    def config(self) -> str:
        """The config of the dataset."""
        return self.manifest.config.name


def text(trained: Trained) -> str:
    """Return the whole README.md."""
    values = {
        "license": front_matter.LICENCE,
        "library_name": LIBRARY,
        "pipeline_tag": "reinforcement-learning",
        "datasets": [trained.dataset],
        "tags": ["imitation-learning", "generalization", "labyrinth", f"arxiv:{ARXIV}"],
    }
    sections = [
        _introduction(trained),
        _loading(trained),
        _training(trained),
        _results(trained),
        "\n".join(["## Limits\n", *(f"- {limit}" for limit in _limits(trained))]),
        f"## Licence and citation\n\nMIT. This card was written by {code()}.\n\n"
        f"```bibtex\n{paper_bibtex()}\n\n{software_bibtex()}\n```",
    ]
    return front_matter.with_values(values, "\n" + "\n\n".join(sections) + "\n")


def _introduction(trained: Trained) -> str:
    size = trained.spec.image_size
    sees = "vectors" if size is None else f"pictures of {size} x {size} pixels"
    figures = trained.results.splits["test"].figures()
    low, high = (f"{100 * bound:.0f}" for bound in figures["sr_interval"])
    url = f"https://huggingface.co/datasets/{trained.dataset}"
    return f"""# {trained.run.method} on `{trained.config}`

A policy that looks at {sees} of grid labyrinths and says where to go: up, right, down or left. It
has learnt from demonstrations on the structures of `train` of [{trained.dataset}]({url}), and
solves {figures["sr"]:.1%} (95% interval {low} to {high}) of the {figures["labyrinths"]:,}
labyrinths of `test`, of which no structure is in `train`."""


def _loading(trained: Trained) -> str:
    shown = ', observation="vector"' if trained.spec.observation == "vector" else ""
    form = "a function from a batch of observations to the scores of the four actions"
    if isinstance(trained.spec.own, MapperSpec):
        shown = f", image_size={trained.spec.image_size}"
        form = "an object with `reset(count)` and `act(observations)`, which returns actions"
    return f"""## Load it

With *Labyrinth datasets* and its extra `train`, which brings PyTorch:

```python
from labyrinth_core import evaluate, load_policy

policy = load_policy("{trained.model}", revision="{trained.version}")
results = evaluate(
    policy, "{trained.dataset}", "{trained.config}", revision="{trained.revision}"{shown}
)
print(results)
```

`policy` is {form}, and
`policy.network` the module of PyTorch. There is no code here: `config.json` says what the network
is made from, and `model.safetensors` has its {trained.weights:,} weights."""


def _training(trained: Trained) -> str:
    run, training = trained.run, trained.run.training
    asked = run.train_labyrinths
    held = sum(shard.labyrinths for shard in trained.manifest.of("train"))
    labyrinths = count(held if asked is None else asked, "labyrinth")
    of = "" if asked is None else f", the first of {held:,}"
    rows = [
        ("dataset", f"`{trained.config}` of `{trained.dataset}`, revision `{trained.revision}`"),
        ("its fingerprint", f"`{run.fingerprint}`"),
        ("learnt from", f"{labyrinths} of `train`{of}"),
        ("method", f"`{run.method}`, encoder `{run.encoder}`, seed {run.seed}"),
        ("settings", ", ".join(f"`{name}={value}`" for name, value in run.settings.items())),
        (
            "budget",
            f"{count(training['epochs'], 'epoch')}, {training['seconds']:.0f} seconds on "
            f"{training['computed']['device']}",
        ),
        (
            "chosen",
            f"the weights after epoch {training['selected']['epoch']}, by the success rate on "
            "`validation`",
        ),
    ]
    return f"## How it learnt\n\n{table(('what', 'value'), rows, 'll')}"


def _results(trained: Trained) -> str:
    rows = []
    for split, scores in trained.results.splits.items():
        figures = scores.figures()
        low, high = figures["sr_interval"]
        efficiency = figures["path_efficiency"]
        chance = trained.results.baselines["random"].get(split)
        rows.append(
            (
                f"`{split}`",
                SPLITS[split].meaning,
                f"{figures['labyrinths']:,}",
                f"{figures['sr']:.1%}",
                f"{100 * low:.0f}-{100 * high:.0f}",
                f"{figures['aer']:.2f} ± {figures['aer_std']:.2f}",
                "-" if efficiency is None else f"{efficiency:.1%}",
                "-" if chance is None else f"{chance['sr']:.1%}",
            )
        )
    heading = ("split", "holds", "labyrinths", "SR", "95%", "AER", "efficiency", "random")
    return f"""## Results

One greedy episode in each labyrinth. *SR*: the share that was solved, with its 95% bootstrap
interval over labyrinths. *AER*: average episodic return, ± its standard deviation; an episode that
fails returns -4. *Efficiency*: moves on a shortest route, divided by moves taken, where it was
solved. *random*: SR of uniformly random actions within the same step limit.

{table(heading, rows, "ll" + "r" * 6)}

`.eval_results/` has the success rates in the Hub's form."""


def _limits(trained: Trained) -> list[str]:
    """Return the points on what the results do not say."""
    points = [
        "It is one run with one seed: the intervals are over labyrinths, and another seed gives "
        "other weights.",
        "The weights were chosen on `validation`, so that figures there flatter it.",
        "It plans once, in the first picture of an episode, and follows that plan."
        if isinstance(trained.spec.own, MapperSpec)
        else "Its action follows from what it sees now: it remembers nothing, and once it comes "
        "back to a state it goes round until the step limit.",
    ]
    if trained.spec.observation == "image":
        points.append(
            "It has learnt from the pictures of one renderer, in one set of colours. Results hold "
            "for those splits and pictures, and say nothing about others, or the real world."
        )
    if isinstance(trained.spec.own, PlannerSpec):
        points.append(
            "It was given prior knowledge that the demonstrations do not have, such as that costs "
            "add up along a path: the settings that are `True` say which."
        )
    return points
