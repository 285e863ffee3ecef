"""Commands that give one answer by one method: their common options, output and exit status.

These are ``fpk density``, ``transient``, ``passage``, ``crossings``, ``spectrum``, ``correlation``
and ``relaxation``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, wraps
from inspect import signature
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click

from cases.command import completed, parts
from cases.scene.errors import BadInput
from fpk.answer.question import Question
from fpk.numeric.errors import InvalidInput, NotApplicable

if TYPE_CHECKING:
    from cases.scene.scene import Scene
    from cases.show.records import Record

LIST = '"-1.5:1.5:0.1", "-1,0,0.3"'


AT = click.option("--at", metavar="LIST", required=True, help=f'{LIST}, a pair "A x B".')
TOL = click.option("--tol", type=float, help="Relative error wanted; a solver adapts to meet it.")
SIMULATED = (parts.seed, parts.seconds, parts.threads, parts.dt)
MEMORY = click.option(
    "--memory",
    type=click.FloatRange(0.0, min_open=True),
    help="GB that a solution of phase-space may need; 4 if left out.",
)


@dataclass(frozen=True)
class Asked:
    """The scene, the method and the options that the user set for it.

    ``solver`` None: any of the method's. ``tol``: the tolerance of the answer, None for the
    method's own. ``settings``: further fields of the method by name, None if not given.
    """

    scene: "Scene"
    method: str
    solver: str | None
    tol: float | None
    settings: dict[str, Any]

    def reply(
        self,
        question: Question,
        about: str,
        given: "Record",
        work: Callable[..., Any],
        **settings: Any,
    ) -> None:
        """Print the answer ``work(method, tol=, progress=)``; status 1 if it is not certified.

        ``about`` names this answer in problems. ``given`` are the entries of the record that repeat
        the ``question``, by which its words are chosen. The first solver that answers is used, or
        ``solver`` alone; ``settings`` are further settings of the method. Raises
        ``BadInput`` for a method that does not answer the question, does not apply, or lacks one
        of the settings, and ``click.exceptions.Exit(1)`` for the status.
        """
        from cases.show import records
        from cases.show.words import reader_words

        method, answer, note, seconds = self._answer(question, work, {**self.settings, **settings})
        record = records.answer_record(self.scene, method, given, answer, seconds, key=question.key)
        failures = record["certificate"]["failures"]
        problems = [f"{about} is not certified: {failure}" for failure in failures]
        record["notes"] = [note] if note else []
        words = map(reader_words, (*record["notes"], *record["averaging_notes"]))
        notes = [f"# {line}" for line in (records.equation_words(record), *words)]
        special = {"passage": records.passage_text, "relaxation": records.rates_text}
        text = special.get(question.name, records.columns_text)
        parts.end(record, lambda: "\n".join([text(record), *notes]), problems=problems)

    def _answer(
        self, question: Question, work: Callable[..., Any], settings: dict[str, Any]
    ) -> tuple[Any, Any, str, float]:
        """The method, answer, a note on a looser tolerance or "", seconds; raises ``BadInput``."""
        from cases.compare.attempts import loosen_tolerance
        from cases.compare.routes import all_routes, methods_of, settings_of
        from cases.show.bar import progress_bar

        start, name, reasons = perf_counter(), self.method, []
        try:
            offered = methods_of(name, self.solver, **settings)
            methods = [method for method in offered if hasattr(method, question.name)]
            for setting, value in sorted(settings.items()) if methods else ():
                known = {*settings_of(methods[0]), "partial", "tol"}
                if value not in (None, False) and setting not in known:
                    by = methods[0].route.solver
                    remedy = f"is not an option of {name} by {by}; leave it out"
                    raise InvalidInput(setting.replace("_", "-"), value, remedy)
            for method in methods:
                try:
                    with progress_bar() as progress:
                        ask = partial(work, method, progress=progress)
                        if self.tol is None:
                            answer, note = loosen_tolerance(ask, lambda own: [own.certificate])
                        else:
                            answer, note = ask(tol=self.tol), ""
                    return method, answer, note, perf_counter() - start
                except NotApplicable as reason:
                    reasons.append(str(reason))
        except InvalidInput as error:
            option = error.key.removeprefix("--")
            raise BadInput(f"--{option} {error.value}: {error.remedy}") from None
        if reasons:
            raise BadInput(f"{self.scene.name}: {name} does not apply: {reasons[0]}")
        able = dict.fromkeys(r.method for r in all_routes() if hasattr(r.make(), question.name))
        raise BadInput(f"{name} gives no {question.words}; use one of {', '.join(able)}")


def asking(*options: Any) -> Callable[[Callable[..., None]], click.Command]:
    """Return a decorator that makes a command of a function ``work(Asked, …)``.

    ``options`` of click, with ``--tol`` among them, are passed to ``work`` if it has a parameter of
    this name, else as ``Asked.settings``; scene, method, solver and ``--json`` are added.
    """

    def command_of(work: Callable[..., None]) -> click.Command:
        own = signature(work).parameters

        @wraps(work)
        def command(scene: str, method: str, solver: str | None, **given: Any) -> None:
            tol = given.pop("tol")
            options = {key: given.pop(key) for key in list(given) if key in own}
            work(
                Asked(parts.load_checked(scene, tol=tol), method, solver, tol, given),
                **options,
            )

        chosen = (
            parts.method(required=True, help="One that gives it; others are refused."),
            click.option(
                "--solver",
                help="One of the solvers of the method.",
                shell_complete=completed.solvers,
            ),
        )
        every = parts.with_options(parts.scene_name, *chosen, *options, parts.as_json)
        return click.command()(every(command))

    return command_of
