"""Classes of light paths: regular expressions over their vertices, as one finite automaton.

The notation is Heckbert's (SIGGRAPH 1990), from the eye on: ``E`` is the eye, ``L`` the light or the sky, and between
them each scattering event is a ``D`` (diffuse), a ``G`` (glossy: rough metal) or an ``S`` (specular: mirror or glass).
``.`` is any of them, ``[DG]`` one of a few; ``( )``, ``|``, ``*``, ``+`` and ``?`` are as everywhere. Spaces do not
count.

Expressions become an automaton by their derivatives (Brzozowski, J. ACM 11 (1964)): what is left of an expression
after one letter is an expression again, and there are finitely many.
"""

from typing import Any, NamedTuple

LETTERS = "DGS"
MOST_STATES = 256

# An expression is a tuple: its kind, then its parts.
Expression = tuple[Any, ...]
NOTHING: Expression = ("nothing",)
EMPTY: Expression = ("empty",)


class Automaton(NamedTuple):
    """Classes as a table: letter ``LETTERS[k]`` leads from state s to ``after[s][k]``, and a path that reaches its
    light in state s is of class ``found[s]``, the first that matches, or ``len(classes)`` where none does. State 0 is
    the eye's."""

    classes: tuple[str, ...]
    after: tuple[tuple[int, ...], ...]
    found: tuple[int, ...]


def automaton(classes) -> Automaton:
    """Return the automaton of several classes, of which the first one that matches counts.

    Raises:
        ValueError: no list of expressions, one that is malformed, or so many that the table grows beyond 256 states.
    """
    if isinstance(classes, str) or not classes or not all(isinstance(c, str) for c in classes):
        raise ValueError(f'classes must be a list of expressions such as ["E D S+ L"], got {classes!r}')
    states, after, found = {tuple(_Parser(c).whole() for c in classes): 0}, [], []
    for state in (todo := list(states)):
        matching = [k for k, expression in enumerate(state) if _can_end(expression)]
        found.append(min(matching, default=len(classes)))
        after.append(())
        for letter in LETTERS:
            reached = tuple(_after(expression, letter) for expression in state)
            if reached not in states:
                states[reached] = len(states)
                todo.append(reached)
            after[-1] += (states[reached],)
        if len(states) > MOST_STATES:
            raise ValueError(
                f"the classes {classes!r} need more than {MOST_STATES} states; ask for fewer or simpler ones"
            )
    return Automaton(tuple(classes), tuple(after), tuple(found))


def classify(machine: Automaton, word: str) -> int:
    """Return the class of a path whose scattering events are the letters of ``word``."""
    state = 0
    for letter in word:
        state = machine.after[state][LETTERS.index(letter)]
    return machine.found[state]


def _either(*parts) -> Expression:
    flat = {q for p in parts for q in (p[1] if p[0] == "either" else (p,))} - {NOTHING}
    return ("either", frozenset(flat)) if len(flat) > 1 else next(iter(flat), NOTHING)


def _then(a, b) -> Expression:
    if NOTHING in (a, b):
        return NOTHING
    if EMPTY in (a, b):
        return b if a == EMPTY else a
    # Chains lean to the right, so that equal ones look equal.
    return ("then", a[1], _then(a[2], b)) if a[0] == "then" else ("then", a, b)


def _many(a) -> Expression:
    return EMPTY if a in (NOTHING, EMPTY) else a if a[0] == "many" else ("many", a)


def _can_end(e) -> bool:
    kind, *parts = e
    if kind == "then":
        return all(map(_can_end, parts))
    return any(map(_can_end, parts[0])) if kind == "either" else kind in ("empty", "many")


def _after(e, letter) -> Expression:
    """Return what may follow ``letter`` in an expression: its derivative."""
    kind, *parts = e
    if kind == "one of":
        return EMPTY if letter in parts[0] else NOTHING
    if kind == "either":
        return _either(*(_after(p, letter) for p in parts[0]))
    if kind == "many":
        return _then(_after(parts[0], letter), e)
    if kind == "then":
        first = _then(_after(parts[0], letter), parts[1])
        return _either(first, _after(parts[1], letter)) if _can_end(parts[0]) else first
    return NOTHING


class _Parser:
    """Reads one expression by recursive descent."""

    def __init__(self, text):
        self.given, self.text = text, "".join(text.split())

    def whole(self) -> Expression:
        if len(self.text) < 2 or self.text[0] != "E" or self.text[-1] != "L":
            self._fail("it must begin with E, the eye, and end with L, the light")
        self.text = self.text[1:-1]
        expression = self._alternatives()
        if self.text:
            self._fail(f"{self.text[0]!r} has no meaning there")
        return expression

    def _alternatives(self):
        options = [self._chain()]
        while self._take("|"):
            options.append(self._chain())
        return _either(*options)

    def _chain(self):
        chain = EMPTY
        while self.text and self.text[0] not in "|)":
            chain = _then(chain, self._repeated())
        return chain

    def _repeated(self):
        part = self._atom()
        while mark := self._take("*+?"):
            part = {"*": _many(part), "+": _then(part, _many(part)), "?": _either(part, EMPTY)}[mark]
        return part

    def _atom(self):
        if self._take("("):
            inside = self._alternatives()
            return inside if self._take(")") else self._fail("a ( is never closed")
        if self._take("["):
            letters, closing, self.text = self.text.partition("]")
            if not closing or not letters or set(letters) - set(LETTERS):
                self._fail("[ ] must hold letters out of D, G and S")
            return ("one of", frozenset(letters))
        letter = self._take(LETTERS + ".")
        if not letter:
            self._fail(f"{self.text[:1]!r} has no meaning there")
        return ("one of", frozenset(LETTERS if letter == "." else letter))

    def _take(self, characters):
        if self.text and self.text[0] in characters:
            taken, self.text = self.text[0], self.text[1:]
            return taken
        return ""

    def _fail(self, why):
        raise ValueError(
            f"{self.given!r} is no class of paths: {why}; write the eye E, events D, G, S or ., with ( ) | * + ? and "
            '[ ], and the light L, such as "E D S+ L"'
        )
