"""What a learner has done, and what is next; for a notebook and for `cotlearn progress`."""

from cotlearn.course import assets, assignments, record

SIGNS = {"correct": "[green]✓[/]", "not yet": "[red]✗[/]", "not attempted yet": "·"}


def progress() -> None:
    """Prints which exercises are done and which is next, from one file on this machine.

    Raises:
        ValueError: If there are no notebooks, or one is damaged.
    """
    from rich.console import Console, Group  # late: few of those who import a check look here
    from rich.markup import escape
    from rich.table import Table

    names = [path.name[:2] for path in assets.notebooks()]
    names += [path.stem for path in assignments.masters()]
    if not names:
        raise ValueError(f"no notebooks in {assets.course_folder()}; get the course again")
    known = {name: item["verdict"] for name, item in record.read().items()}
    table, left = Table(box=None, show_header=False, pad_edge=False), []
    for assignment in map(assignments.find, names):
        verdicts = [known.get(item.name, "not attempted yet") for item in assignment.questions]
        done = f"{verdicts.count('correct')} of {len(verdicts)}"
        table.add_row(escape(assignment.title), done, " ".join(SIGNS[v] for v in verdicts))
        for item, verdict in zip(assignment.questions, verdicts, strict=True):
            if verdict != "correct":
                left.append(f"{item.name} in {assignment.path.name}")
    last = escape(f"next: {left[0]}" if left else "all exercises are done")
    kept = f"kept in {escape(str(record.file()))}, and sent nowhere"
    # in one piece: a notebook leaves a gap between prints, and clips the last line's underscores
    Console(highlight=False, soft_wrap=True).print(Group(table, f"{last}\n{kept}", ""))
