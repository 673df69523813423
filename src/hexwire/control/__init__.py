"""The one owner of a moving robot. Knows no front: no middleware, no terminal, no page."""
