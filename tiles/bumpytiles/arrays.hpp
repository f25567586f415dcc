// Arrays of numpy as the compiled loops see them: the caller's memory with its shape, one index an axis. Nothing is
// copied, converted or owned: an array of another kind of number, another layout, or one that may not be written is
// refused with a TypeError. `Array<const T>` is read only. Axes are in C order.
#pragma once

#include <array>
#include <cassert>
#include <cstdint>
#include <vector>

namespace bumpy {

using Index = std::int64_t;

template <class T, int Axes = 1>
struct Array {
    T* data = nullptr;
    std::array<Index, Axes> shape{};

    Index size() const requires(Axes == 1) { return shape[0]; }

    Index count() const {
        Index product = 1;
        for (const Index length : shape) product *= length;
        return product;
    }

    T& operator[](Index i) const requires(Axes == 1) {
        assert(0 <= i && i < shape[0]);
        return data[i];
    }

    // The element at an index for each axis.
    template <class... Indices>
    T& operator()(Indices... indices) const requires(sizeof...(Indices) == Axes) {
        Index place = 0;
        std::size_t axis = 0;
        const auto step = [&](Index i) {
            assert(0 <= i && i < shape[axis]);
            place = place * shape[axis++] + i;
        };
        (step(static_cast<Index>(indices)), ...);
        return data[place];
    }

    // The array behind an index of the first axis.
    Array<T, Axes - 1> at(Index i) const requires(Axes > 1) {
        assert(0 <= i && i < shape[0]);
        Array<T, Axes - 1> part;
        Index step = 1;
        for (std::size_t axis = 1; axis < Axes; ++axis) {
            part.shape[axis - 1] = shape[axis];
            step *= shape[axis];
        }
        part.data = data + i * step;
        return part;
    }

    // Elements `first` up to but not with `last` of the first axis.
    Array slice(Index first, Index last) const {
        assert(0 <= first && first <= last && last <= shape[0]);
        Array part = *this;
        const Index step = shape[0] > 0 ? count() / shape[0] : 0;
        part.data = data + first * step;
        part.shape[0] = last - first;
        return part;
    }

    T* begin() const requires(Axes == 1) { return data; }
    T* end() const requires(Axes == 1) { return data + shape[0]; }

    operator Array<const T, Axes>() const requires(!std::is_const_v<T>) { return {data, shape}; }
};

// Numbers of a vector as the loops take them.
template <class Number>
Array<Number> view(std::vector<Number>& numbers) {
    return {numbers.data(), {std::ssize(numbers)}};
}
template <class Number>
Array<const Number> view(const std::vector<Number>& numbers) {
    return {numbers.data(), {std::ssize(numbers)}};
}

}  // namespace bumpy
