"""Claims: sentences of the course that a notebook cell asserts on every run."""

#: Prefix of a printed claim; the notebook runner counts the lines that start with it.
HOLDS = "✓ claim: "


def claim(sentence: str, holds: bool) -> None:
    """Prints a claim if it holds; otherwise raises an error, which stops the notebook.

    Args:
        sentence: The claim in words, preferably with the measured numbers.
        holds: Whether the claim is true: a `bool`, a NumPy bool or a tensor with one element.

    Raises:
        AssertionError: If the claim does not hold.
        TypeError: If `sentence` is not a string.
        ValueError: If `sentence` is empty, or `holds` has no single truth value.

    Example:
        >>> claim("one plus one is 2", 1 + 1 == 2)
        ✓ claim: one plus one is 2
    """
    if not isinstance(sentence, str):
        raise TypeError(f"sentence must be a string, got {type(sentence).__name__}")
    if not sentence.strip():
        raise ValueError("sentence is empty; expected the claim in words")
    try:
        true = bool(holds)
    except (RuntimeError, ValueError) as error:
        raise ValueError(
            f"holds must be one truth value, got {type(holds).__name__} with several; "
            "reduce it with .all() or .any()"
        ) from error
    if not true:
        raise AssertionError(f"claim does not hold: {sentence}")
    print(HOLDS + " ".join(sentence.split()))


def count_claims(text: str) -> int:
    """Counts the claims in `text`, the printed output of a notebook."""
    return sum(line.startswith(HOLDS) for line in text.splitlines())
