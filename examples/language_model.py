"""A language model in labyrinths, by inspect-ai: text or picture in, a route out, replayed.

    labyrinth-datasets size=5 'shifts=[longer,recoloured]' 'stages=[build,questions]'
    inspect eval examples/language_model.py --model openai/gpt-5
    inspect eval examples/language_model.py -T picture=true -T splits=test --model openai/gpt-5

Needs, in a clone: pip install . inspect-ai
"""

from datasets import load_dataset
from inspect_ai import Task, task
from inspect_ai.dataset import Sample
from inspect_ai.model import ChatMessageUser, ContentImage, ContentText
from inspect_ai.scorer import Score, Scorer, Target, grouped, mean, scorer, stderr
from inspect_ai.solver import TaskState, generate

from labyrinth_core import score_answer

BY_SPLIT = [grouped(mean(), "split"), stderr()]


def sample_of(row: dict, split: str, picture: bool) -> Sample:
    """Return a row of a config such as 5x5-questions as a sample, with text or with picture."""
    shown = row["prompt"]
    if picture:
        parts = [ContentText(text=row["picture_prompt"]), ContentImage(image=row["image_url"])]
        shown = [ChatMessageUser(content=parts)]
    facts = {"split": split, "info": row["info"]}
    name = f"{split}-{row['labyrinth_id']}"
    return Sample(input=shown, target=row["routes"], id=name, metadata=facts)


@scorer(metrics={"solved": BY_SPLIT, "shortest": BY_SPLIT, "legal": BY_SPLIT})
def replayed() -> Scorer:
    """Replay the moves of an answer, in the labyrinth: every shortest route counts the same."""

    async def score(state: TaskState, _target: Target) -> Score:
        found = score_answer(state.metadata["info"], state.output.completion)
        legal = bool(found.moves) and found.illegal_move is None
        value = {"solved": found.reaches_goal, "shortest": found.is_shortest, "legal": legal}
        moves = " ".join(move.name.lower() for move in found.moves)
        facts = {"extra_moves": found.extra_moves, "illegal_move": found.illegal_move}
        return Score(value=value, answer=moves, explanation=found.reason, metadata=facts)

    return score


@task
def labyrinths(source="../data/labyrinth", config="5x5", splits=None, picture=False) -> Task:
    """Ask for a route through each labyrinth; the splits, test and shifts, are the conditions.

    The source is an id on the Hub, or a folder: inspect-ai takes its path from this file's folder.
    """
    asked = load_dataset(source, f"{config}-questions").remove_columns(["image", "image_300"])
    chosen = splits.split(",") if isinstance(splits, str) else splits or list(asked)
    samples = [sample_of(row, split, picture) for split in chosen for row in asked[split]]
    return Task(samples, solver=generate(), scorer=replayed())
