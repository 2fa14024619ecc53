"""`python -m cotlearn.course` rewrites `data/SHA256SUMS`, after a change of the data."""

from cotlearn.course import assets

if __name__ == "__main__":
    print(assets.write_sums().read_text(encoding="utf-8"), end="")
