"""The lower envelope of parabolas, by which exact distance transforms measure along a line.

Each place on a line from which distances spread is a parabola: its height there is a squared
distance, and it grows with the square of the offset along the line. The lowest parabola at a place
is the nearest one, see Felzenszwalb and Huttenlocher, "Distance Transforms of Sampled Functions"
(2012).
"""

import math

from navbake.compiled import subkernel


@subkernel
def add_parabola(places, heights, bounds, num_parabolas, place, height):
    """Add a parabola to the envelope of those whose places are less than its own.

    Args:
        places: places of the envelope's parabolas, ascending, with room for one more, float64.
        heights: their squared distances at these places, float64.
        bounds: from where on each of them is the lowest, then inf, float64; one entry more.
        num_parabolas: how many parabolas the envelope has.
        place: the place of the parabola to add.
        height: its squared distance there.

    Returns:
        How many parabolas the envelope has now.
    """
    bound = -math.inf
    while num_parabolas > 0:
        other = places[num_parabolas - 1]
        difference = height + place * place
        difference -= heights[num_parabolas - 1] + other * other
        bound = difference / (2.0 * (place - other))
        if bound > bounds[num_parabolas - 1]:
            break
        num_parabolas -= 1
    places[num_parabolas] = place
    heights[num_parabolas] = height
    bounds[num_parabolas] = bound
    bounds[num_parabolas + 1] = math.inf
    return num_parabolas + 1
