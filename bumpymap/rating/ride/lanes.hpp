// Numbers of several patches side by side (*lanes*), of which a processor computes a register full at once.
//
// Written as loops over so few numbers, compilers take them apart, and they are three times as slow.
#pragma once

#include <type_traits>
#include <utility>

#include "bumpytiles/arrays.hpp"

namespace bumpy {

using Floats8 [[gnu::vector_size(32)]] = float;
using Doubles4 [[gnu::vector_size(32)]] = double;

// One number of each of `group` patches; arithmetic goes part by part. Registers are passed by reference alone: how
// they are passed by value differs between builds.
template <class Register, int group>
struct Lanes {
    using Number = std::remove_reference_t<decltype(std::declval<Register&>()[0])>;
    static constexpr Index width = sizeof(Register) / sizeof(Number);

    std::array<Register, group / width> part;

    Lanes() = default;
    Lanes(Number value) { part.fill(value - Register{}); }

    auto operator[](Index lane) const { return part[lane / width][lane % width]; }
    void set(Index lane, Number value) { part[lane / width][lane % width] = value; }

    template <class Change>
    Lanes& change(const Lanes& by, Change one) {
        for (std::size_t p = 0; p < part.size(); ++p) one(part[p], by.part[p]);
        return *this;
    }

    Lanes& operator+=(const Lanes& by) {
        return change(by, [](auto& own, const auto& other) { own += other; });
    }
    Lanes& operator-=(const Lanes& by) {
        return change(by, [](auto& own, const auto& other) { own -= other; });
    }
    Lanes& operator*=(const Lanes& by) {
        return change(by, [](auto& own, const auto& other) { own *= other; });
    }
    Lanes& operator/=(const Lanes& by) {
        return change(by, [](auto& own, const auto& other) { own /= other; });
    }
    friend Lanes operator+(Lanes a, const Lanes& b) { return a += b; }
    friend Lanes operator-(Lanes a, const Lanes& b) { return a -= b; }
    friend Lanes operator*(Lanes a, const Lanes& b) { return a *= b; }
    friend Lanes operator/(Lanes a, const Lanes& b) { return a /= b; }

    // Raises the numbers to others, where these are larger.
    void raise(const Lanes& to) {
        change(to, [](auto& own, const auto& other) { own = own < other ? other : own; });
    }
};

}  // namespace bumpy
