"""Commands that are still written for click, and what they share."""
