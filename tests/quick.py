"""Loaded by pytest before its plugins, of which nbval imports jsonschema.

With this package, which nothing here needs, jsonschema takes a second or two longer to import.
"""

import sys

sys.modules.setdefault("rfc3987_syntax", None)
