"""From where to go to the attitude, height and heading that the loops are asked for, within what they can follow."""
