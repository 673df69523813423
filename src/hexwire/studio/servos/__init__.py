"""What the page Servos asks of the server: one file for each thing that is done with a servo, without drawing."""
