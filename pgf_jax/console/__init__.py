"""The console: a person guides a fleet from a browser while it runs in real time.

Read `command.py` first: it is the flow of a session. `session.py` runs the fleet by the wall clock,
`input_panel.py` is what the operator picks, `page.py` is the page in the browser (viser), and
`access_control.py` decides who may connect. `layout.py`, `fleet_view.py` and `drawing.py` draw the
robots, and `legend.py` says what their colours mean.

Imports `sweeping`, `operator_fit` and what is below them.
"""
