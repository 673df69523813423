"""The studio: the arm, its servos and its wire in a browser. Only this room imports Starlette and its server."""
