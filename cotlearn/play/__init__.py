"""The playground: panels in a browser that show couplings, on one page or in a notebook.

The panels are small ES modules. Browsers do not import modules from a disk, so Python joins them
into one script, which works on a page without a server and in a notebook's widget alike.
"""

from cotlearn.play.page import write_page

__all__ = ["write_page"]
