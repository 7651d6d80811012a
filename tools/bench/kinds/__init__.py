"""The kinds of scenes: a module each, whose `make` returns a `Subject` drawn from a generator.

The motion of an original kind spans the clip: its `make` also takes the clip's length in seconds. That of the others
is a function of seconds alone.
"""

from kinds import cart, contact, deform, gloss, mill, pendulum, quad, toys, walker

ORIGINAL = {"mill": mill.make, "quad": quad.make, "toys": toys.make}
FREE = {
    "cart": cart.make,
    "contact": contact.make,
    "deform": deform.make,
    "gloss": gloss.make,
    "pendulum": pendulum.make,
    "walker": walker.make,
}
NAMES = (*ORIGINAL, *FREE)
