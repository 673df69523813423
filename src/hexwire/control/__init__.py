"""The one owner of a moving robot. Knows neither ROS nor a terminal nor a page."""
