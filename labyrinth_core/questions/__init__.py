"""Questions about labyrinths for vision and language models, and the scores of their answers.

`question` makes a question of a labyrinth, and `score_answer` replays the moves of an answer.
"""

from labyrinth_core.questions.questions import QUESTION_COLUMNS, question
from labyrinth_core.questions.written_routes import RouteScore, score_answer

__all__ = ["QUESTION_COLUMNS", "RouteScore", "question", "score_answer"]
