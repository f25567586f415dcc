// Numbers of several patches side by side (*lanes*), of which a processor computes a register full at once.
//
// Written as loops over so few numbers, compilers take them apart, and they are three times as slow.
#pragma once

#include "bumpytiles/arrays.hpp"

namespace bumpy {

using Floats8 [[gnu::vector_size(32)]] = float;
using Doubles4 [[gnu::vector_size(32)]] = double;

// One number of each of `group` patches; arithmetic goes part by part.
template <class Register, int group>
struct Lanes {
    static constexpr Index width = sizeof(Register) / sizeof(Register{}[0]);

    std::array<Register, group / width> part;

    auto operator[](Index lane) const { return part[lane / width][lane % width]; }
    void set(Index lane, auto value) { part[lane / width][lane % width] = value; }
    void fill(auto value) { part.fill(Register{} + value); }
};

// Raises numbers to others, where these are larger. Registers are passed by reference: how they are passed by value
// differs between builds.
template <class Register>
void raise(Register& numbers, const Register& others) {
    numbers = numbers < others ? others : numbers;
}

}  // namespace bumpy
