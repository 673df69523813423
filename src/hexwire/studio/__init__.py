"""The studio: the arm, its servos and its wire in a browser. Only this room imports NiceGUI and Starlette."""
