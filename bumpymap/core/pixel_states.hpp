// Numbers of states of pixels and of kinds of points, as in types.py, which explains them.
#pragma once

#include <cstdint>

namespace bumpy {

enum PixelState : std::uint8_t {
    FREE = 0,
    OBSTACLE = 1,
    CANOPY = 2,
    UNDECIDED = 3,
    LONE = 4,
    SOLID = 5,
    EMPTY = 6,
    STEEP = 7,
    LOW_SOLID = 9,
    MAYBE_SOLID = 10,
    SEEN = 16,  // added to a state: ground was seen in the pixel
    UNSEEN = 255,
};

enum PointKind : std::uint8_t {
    POINT_OTHER,
    POINT_GROUND,
    POINT_BUILDING,
    POINT_PLANT,
    POINT_DECK,
    POINT_CLASSED,
};

// True if a state is that of something over the vehicle.
inline bool is_overhead(int state) {
    const int kind = state % SEEN;
    return kind == CANOPY || kind == SOLID || kind == LOW_SOLID || kind == MAYBE_SOLID;
}

}  // namespace bumpy
