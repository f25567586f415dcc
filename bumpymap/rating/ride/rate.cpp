// The noise of a heightmap, and what of it is ground; the shares of the normal distribution.
//
// A patch goes through the cosine transform; its coefficients are gathered in bands of equal wave number, the likeliest
// ground spectrum is fitted to the powers of the bands (Whittle's likelihood), and each coefficient shrinks to its
// share of ground. Eight patches go side by side (*lanes*), where nothing depends on their order: the sums over one
// patch keep theirs, and so their bits. Ours; see rate.py for the model.
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "bumpytiles/bindings.hpp"
#include "lanes.hpp"

namespace bumpy {
namespace {

constexpr int group = 8;  // patches side by side
using Numbers = Lanes<Doubles4, group>;

// Points beyond one a pixel, that many at least, or the noise of a tile is not known.
constexpr double least_freedom = 10.0;
// Variance, m^2. Points that scatter by more than 0.1 m inside a pixel are leaves over ground, or blocks: a scanner is
// better than that. What is beyond stays in the ground.
constexpr double most_noise = 0.01;
// Noise variance of a pixel that was filled, over that of one that was seen: a mean of some neighbours.
constexpr double filled_noise = 0.4;
// A coefficient whose square is that many times its noise is ground, whatever its neighbours say (p = 0.003).
constexpr double significant = 9.0;
// Steps to the strength of the ground's spectrum.
constexpr int rounds = 12;
// The first strength of a spectrum is that of so much of the noise, at least.
constexpr double least_share = 0.01;
// Strengths of a spectrum, and powers of a pixel, below this are none.
constexpr double tiny = 1e-12;

struct Spectrum {
    Array<const double, 2> basis, turned;
    Array<const std::int32_t, 2> band;
    Array<const double, 2> shapes;
};

// ---- Noise of points and pixels ----

struct Weighted {
    double value, weight;
};

// Brings what belongs to the front of a part there; returns where the rest begins, and the weight of what is before it.
template <class Belongs>
std::pair<Weighted*, double> split(Weighted* first, Weighted* last, Belongs belongs) {
    Weighted* const rest = std::partition(first, last, [&](const Weighted& each) { return belongs(each.value); });
    double total = 0.0;
    for (const Weighted* each = first; each < rest; ++each) total += each->weight;
    return {rest, total};
}

// The first of the values in order at which the sum of the weights, integers, reaches `half`; their order is changed.
double weighted_median(std::vector<Weighted>& values, double half) {
    Weighted *first = values.data(), *last = first + values.size();
    double below = 0.0;
    while (true) {
        const double a = first->value, b = first[(last - first) / 2].value, c = last[-1].value;
        const double pivot = std::max(std::min(a, b), std::min(std::max(a, b), c));
        const auto [at, lower] = split(first, last, [pivot](double value) { return value < pivot; });
        if (below + lower >= half) {
            last = at;
            continue;
        }
        const auto [rest, equal] = split(at, last, [pivot](double value) { return value == pivot; });
        first = rest;
        below += lower + equal;
        if (below >= half || equal == 0.0) return pivot;  // nothing equals NaN
    }
}

// The noise variance of a single point, m^2; NaN where too few pixels hold two points.
//
// The median of the pixels' own variances, each as often as it has degrees of freedom: an edge inside some pixels does
// not move it. A median of chi-square numbers is too low by (1 - 2 / (9 k))^3.
double point_noise(Array<const std::int32_t, 2> count, Array<const float, 2> variance) {
    std::vector<Weighted> values;
    double total = 0.0, squares = 0.0;
    for (Index k = 0; k < count.count(); ++k) {
        if (count.data[k] <= 1) continue;
        const double weight = count.data[k] - 1;
        values.push_back({variance.data[k] * (weight + 1.0) / weight, weight});
        total += weight;
        squares += weight * weight;
    }
    if (total < least_freedom) return std::numeric_limits<double>::quiet_NaN();
    const double median = weighted_median(values, 0.5 * total), root = 1.0 - 2.0 * total / (9.0 * squares);
    return std::min(median / (root * root * root), most_noise);
}

// The mean noise variance of the pixels' heights, m^2.
double pixel_noise(Array<const std::int32_t, 2> count, double point) {
    double seen = 0.0, total = 0.0;
    for (Index k = 0; k < count.count(); ++k) {
        if (count.data[k] <= 0) continue;
        ++seen;
        total += point / count.data[k];
    }
    if (seen == 0.0) return std::numeric_limits<double>::quiet_NaN();
    const auto pixels = static_cast<double>(count.count());
    return (total + (pixels - seen) * filled_noise * total / seen) / pixels;
}

// ---- The ground of a group of patches ----

class Group {
  public:
    explicit Group(const Spectrum& given)
        : spectrum(given),
          size(given.basis.shape[0]),
          patch(size * size, 1.0),
          middle(patch),
          waves(patch),
          number(given.shapes.shape[1]),
          powers(number.size()),
          ground(number.size()),
          noise(1.0) {
        for (const std::int32_t b : Array<const std::int32_t>{spectrum.band.data, {spectrum.band.count()}})
            if (b >= 0) ++number[b];
    }

    bool is_empty() const { return held == 0; }
    bool is_full() const { return held == group; }

    // Takes a patch with its place among all, and the noise variance of its pixels' heights, m^2.
    void take(Index place, Array<const float, 2> relief, double variance) {
        for (Index k = 0; k < relief.count(); ++k) patch[k].set(held, relief.data[k]);
        noise.set(held, variance);
        members[held++] = place;
    }

    // Takes the noise out of the patches, and begins the next group.
    void clean(Array<float, 3> out) {
        transform(spectrum.basis, patch, waves);
        band_powers();
        fit_spectra();
        shrink();
        transform(spectrum.turned, waves, patch);
        for (Index lane = 0; lane < held; ++lane) {
            float* const relief = &out(members[lane], 0, 0);
            for (Index k = 0; k < size * size; ++k) relief[k] = static_cast<float>(patch[k][lane]);
        }
        held = 0;
    }

  private:
    // Multiplies patches by a matrix from the left, and by its transpose from the right: the cosine transform, or back.
    void transform(Array<const double, 2> matrix, const std::vector<Numbers>& from, std::vector<Numbers>& out) {
        const auto multiply = [this, matrix](const std::vector<Numbers>& right, std::vector<Numbers>& transposed) {
            for (Index j = 0; j < size; ++j) {
                for (Index i = 0; i < size; ++i) {
                    Numbers total{};
                    for (Index k = 0; k < size; ++k) total += matrix(i, k) * right[k * size + j];
                    transposed[j * size + i] = total;
                }
            }
        };
        multiply(from, middle);
        multiply(middle, out);
    }

    // The mean square of the coefficients of each band.
    void band_powers() {
        std::fill(powers.begin(), powers.end(), Numbers{});
        for (Index k = 0; k < size * size; ++k) {
            const std::int32_t b = spectrum.band.data[k];
            if (b < 0) continue;
            powers[b] += waves[k] * waves[k];
        }
        for (Index b = 0; b < std::ssize(number); ++b) powers[b] /= number[b];
    }

    // The strength A of a ground spectrum A * shape beside white noise, by weighted steps (Whittle's likelihood).
    Numbers strength_of(Array<const double> shape) const {
        Numbers strength{};
        double shapes = 0.0;
        for (Index b = 0; b < shape.size(); ++b) {
            strength += number[b] * (powers[b] - noise);
            shapes += number[b] * shape[b];
        }
        strength.raise(least_share * noise);
        strength /= shapes;
        for (int round = 0; round < rounds; ++round) {
            Numbers top{}, bottom{};
            for (Index b = 0; b < shape.size(); ++b) {
                const Numbers share = shape[b] / (strength * shape[b] + noise);
                const Numbers weight = number[b] * share * share;
                top += weight * (powers[b] - noise) / shape[b];
                bottom += weight;
            }
            strength = top / bottom;
            strength.raise(tiny);
        }
        return strength;
    }

    // Fills the likeliest power of each band, m^2.
    void fit_spectra() {
        std::array<double, group> best{};
        for (Index s = 0; s < spectrum.shapes.shape[0]; ++s) {
            const Array<const double> shape = spectrum.shapes.at(s);
            const Numbers strength = strength_of(shape);
            for (int lane = 0; lane < group; ++lane) {
                double misfit = 0.0;
                for (Index b = 0; b < shape.size(); ++b) {
                    const double power = strength[lane] * shape[b] + noise[lane];
                    misfit += number[b] * (powers[b][lane] / power + std::log(power));
                }
                if (s > 0 && misfit >= best[lane]) continue;
                best[lane] = misfit;
                for (Index b = 0; b < shape.size(); ++b) ground[b].set(lane, strength[lane] * shape[b]);
            }
        }
    }

    // Shrinks each coefficient to the power that is the ground's, the mean to nothing.
    void shrink() {
        for (Index k = 0; k < size * size; ++k) {
            const std::int32_t b = spectrum.band.data[k];
            for (int lane = 0; lane < group; ++lane) {
                const double wave = waves[k][lane], power = wave * wave, likely = ground[std::max(b, 0)][lane];
                const bool is_ground = power > significant * noise[lane];
                const double kept = is_ground ? (power - noise[lane]) / power : likely / (likely + noise[lane]);
                waves[k].set(lane, b < 0 ? 0.0 : wave * std::sqrt(kept));
            }
        }
    }

    Spectrum spectrum;
    Index size, held = 0;
    std::vector<Numbers> patch, middle, waves;  // (pixels, pixels) as they are, half transformed, and transformed
    std::vector<double> number;                 // coefficients of each band
    std::vector<Numbers> powers, ground;        // of each band: mean square of the coefficients; the ground's, m^2
    Numbers noise;                              // variance of a pixel's height, m^2
    std::array<Index, group> members{};
};

// Takes the scan's noise out of known patches: fills `clean` relief, m, and `noise` (2, tiles), the standard deviation
// of a point and of a pixel's height, m.
void denoise_patches(
    Array<const bool> known, Array<const float, 3> reliefs, Array<const std::int32_t, 3> counts,
    Array<const float, 3> variances, Spectrum spectrum, Array<float, 3> clean, Array<double, 2> noise) {
    Group side_by_side(spectrum);
    for (Index t = 0; t < known.size(); ++t) {
        if (!known[t]) continue;
        const Array<const float, 2> relief = reliefs.at(t);
        const double point = point_noise(counts.at(t), variances.at(t)), pixel = pixel_noise(counts.at(t), point);
        noise(0, t) = std::sqrt(point);
        noise(1, t) = std::sqrt(pixel);
        std::copy_n(relief.data, relief.count(), &clean(t, 0, 0));
        if (pixel > tiny) side_by_side.take(t, relief, pixel);  // without noise it stays as it is
        if (side_by_side.is_full()) side_by_side.clean(clean);
    }
    if (!side_by_side.is_empty()) side_by_side.clean(clean);
}

// Fills the share of the standard normal distribution below each z.
void normal_shares(Array<const double> z, Array<double> share) {
    for (Index i = 0; i < z.size(); ++i) share[i] = 0.5 * std::erfc(-z[i] / std::sqrt(2.0));
}

}  // namespace
}  // namespace bumpy

BUMPY_RECORD(bumpy::Spectrum, basis, turned, band, shapes)

BUMPY_LOOPS(rate, point_noise, denoise_patches, normal_shares)
