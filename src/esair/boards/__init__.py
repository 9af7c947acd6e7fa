"""For microcontrollers: drivers over ``machine``, and what puts a robot on a board.

The drivers are plain Python for `esair.minimal`; each file is copied to the board when a
robot names it. They import ``machine`` when they are opened, so that they can be made,
checked and tested on a computer.
"""
