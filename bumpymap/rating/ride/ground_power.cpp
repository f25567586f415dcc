// How likely strengths of ground and noise are, by the points of a tile.
//
// Heights about a plane are waves of the ground, whose powers have one strength and fall with the wave number, and
// white noise. The sums of the points over the waves are reduced to a tridiagonal matrix with the heights as its first
// row (Householder's reflections): then the likelihood of each strength of ground and noise takes one pass over its
// rows. Ours; see thin.py.
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "bumpytiles/bindings.hpp"

namespace bumpy {
namespace {

// Coefficients of a plane.
constexpr Index plane = 3;
// A pivot or a column that is smaller by that factor than it was is a rounding error.
constexpr double tiny = 1e-12;
// Rows whose product is taken before its logarithm: it stays far from overflow.
constexpr Index rows_at_once = 4;

// A square matrix of which the lower triangle counts, row by row.
struct Square {
    Index size;
    std::vector<double> cell;

    explicit Square(Index side) : size(side), cell(side * side) {}
    double* row(Index i) { return cell.data() + i * size; }
    double& operator()(Index i, Index j) { return cell[i * size + j]; }
};

// Takes out the first columns: what is left are the sums about their least-squares fit. False if they hang together.
bool eliminate(Square& sums, Index columns) {
    for (Index k = 0; k < columns; ++k) {
        const double pivot = sums(k, k);
        if (!(pivot > tiny)) return false;
        for (Index i = k + 1; i < sums.size; ++i) {
            const double factor = sums(i, k) / pivot;
            double* const own = sums.row(i);
            for (Index j = k + 1; j <= i; ++j) own[j] -= factor * sums(j, k);
        }
    }
    return true;
}

// Reduces the part from `first` on to a tridiagonal matrix; fills its diagonal and the squares beside it.
void reduce(Square& sums, Index first, Array<float> diagonal, Array<float> beside) {
    const Index size = sums.size;
    std::vector<double> v(size), p(size);
    for (Index k = first; k < size; ++k) {
        diagonal[k - first] = static_cast<float>(sums(k, k));
        if (k + 1 == size) break;
        double norm = 0.0;
        for (Index i = k + 1; i < size; ++i) norm += sums(i, k) * sums(i, k);
        beside[k - first] = static_cast<float>(norm);
        if (k + 2 == size || !(norm > 0.0)) continue;
        const double head = sums(k + 1, k), alpha = std::copysign(std::sqrt(norm), -head);
        for (Index i = k + 1; i < size; ++i) v[i] = sums(i, k);
        v[k + 1] -= alpha;
        const double scale = 1.0 / (norm - alpha * head);  // 2 / v.v
        std::fill(p.begin(), p.end(), 0.0);
        for (Index i = k + 1; i < size; ++i) {
            const double* const own = sums.row(i);
            double total = 0.0;
            for (Index j = k + 1; j < i; ++j) {
                total += own[j] * v[j];
                p[j] += own[j] * v[i];
            }
            p[i] += total + own[i] * v[i];
        }
        double along = 0.0;
        for (Index i = k + 1; i < size; ++i) along += v[i] * (p[i] *= scale);
        for (Index i = k + 1; i < size; ++i) p[i] -= 0.5 * scale * along * v[i];
        for (Index i = k + 1; i < size; ++i) {
            double* const own = sums.row(i);
            for (Index j = k + 1; j <= i; ++j) own[j] -= v[i] * p[j] + p[i] * v[j];
        }
    }
}

// Fills the sums of some tiles, see thin.py; NaN for the others and where the points span no plane.
// `waves` (pixels^2, 3 + k): a plane and the waves at the pixels, by the square root of their power.
void sum_waves(
    Array<const bool> wanted, Array<const float, 3> reliefs, Array<const std::int32_t, 3> counts,
    Array<const float, 3> variances, Array<const double, 2> waves, Array<float, 2> out) {
    const Index columns = waves.shape[1], rest = columns - plane + 1;
    std::vector<double> line(columns + 1);
    for (Index t = 0; t < wanted.size(); ++t) {
        const Array<float> sums_of = out.at(t);
        std::fill(sums_of.begin(), sums_of.end(), std::numeric_limits<float>::quiet_NaN());
        if (!wanted[t]) continue;
        const Array<const float, 2> relief = reliefs.at(t), variance = variances.at(t);
        const Array<const std::int32_t, 2> count = counts.at(t);
        Square sums(columns + 1);
        double points = 0.0;
        for (Index k = 0; k < count.count(); ++k) {
            const auto weight = static_cast<double>(count.data[k]);
            if (weight == 0.0) continue;
            points += weight;
            const double* const wave = waves.data + k * columns;
            std::copy_n(wave, plane, line.begin());
            line[plane] = relief.data[k];
            std::copy_n(wave + plane, columns - plane, line.begin() + plane + 1);
            for (Index i = 0; i <= columns; ++i) {
                double* const own = sums.row(i);
                const double factor = weight * line[i];
                for (Index j = 0; j <= i; ++j) own[j] += factor * line[j];
            }
            if (weight > 1.0) sums(plane, plane) += weight * variance.data[k];
        }
        if (points <= plane || !eliminate(sums, plane)) continue;
        sums_of[0] = static_cast<float>(points - plane);
        reduce(sums, plane, sums_of.slice(1, 1 + rest), sums_of.slice(1 + rest, 2 * rest));
    }
}

// Fills ln of the likelihoods (tiles, noises, grounds) of the standard deviations of noise and ground, m; 0 for tiles
// whose sums are NaN. `white`: share of the ground's power in waves too short for the sums.
void weigh_strengths(
    Array<const float, 2> sums, Array<const double> noises, Array<const double> grounds, double white,
    Array<float, 3> out) {
    const Index rows = sums.shape[1] / 2 - 1, number = grounds.size();
    std::vector<double> variance(number), ratio(number), step(number), product(number), log_det(number);
    for (Index t = 0; t < sums.shape[0]; ++t) {
        const Array<const float> own = sums.at(t);
        const double freedom = own[0], squares = own[1], along = own[rows + 2];
        for (Index s = 0; s < noises.size(); ++s) {
            float* const found = &out(t, s, 0);
            if (std::isnan(freedom)) {
                std::fill_n(found, number, 0.0F);
                continue;
            }
            for (Index a = 0; a < number; ++a) {
                const double power = grounds[a] * grounds[a];
                variance[a] = noises[s] * noises[s] + white * power;
                ratio[a] = power / variance[a];
                step[a] = product[a] = 1.0;
                log_det[a] = 0.0;
            }
            for (Index i = rows; i > 0; --i) {
                const double diagonal = own[i + 1], beside = i < rows ? own[rows + 2 + i] : 0.0F;
                for (Index a = 0; a < number; ++a) {
                    step[a] = 1.0 + ratio[a] * diagonal - ratio[a] * ratio[a] * beside / step[a];
                    step[a] = std::max(step[a], 1.0);
                    product[a] *= step[a];
                }
                if (i % rows_at_once != 1) continue;
                for (Index a = 0; a < number; ++a) {
                    log_det[a] += std::log(product[a]);
                    product[a] = 1.0;
                }
            }
            for (Index a = 0; a < number; ++a) {
                const double left = std::max(squares - ratio[a] * along / step[a], 0.0);
                found[a] =
                    static_cast<float>(-0.5 * (freedom * std::log(variance[a]) + log_det[a] + left / variance[a]));
            }
        }
    }
}

}  // namespace
}  // namespace bumpy

BUMPY_LOOPS(ground_power, sum_waves, weigh_strengths)
