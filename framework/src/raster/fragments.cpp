// Stage 5: what is visible is interpolated, and nothing else.
#include "raster/lanes.hpp"
#include "raster/stages.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace shadelab {

namespace {

constexpr uint32_t no_slot = 0xffffffff;

/// Divides interpolated rows (n.xyz, sum, x.xyz, 0) by the sum, makes n unit and, with View, v the unit vector to the eye. The
/// arrays are restrict parameters: otherwise the compiler must assume that they overlap, and the loop stays scalar.
template <bool View, class Real>
void finish(int count, const Real* __restrict rows, glm::vec<3, Real> eye, Real* __restrict nx, Real* __restrict ny,
            Real* __restrict nz, Real* __restrict xx, Real* __restrict xy, Real* __restrict xz, Real* __restrict vx,
            Real* __restrict vy, Real* __restrict vz, Real* __restrict squared) {
    for (int i = 0; i < count; ++i) {
        const Real* row = rows + 8 * i;
        const Real inverse = 1 / row[3];
        const Real n0 = row[0] * inverse, n1 = row[1] * inverse, n2 = row[2] * inverse;
        const Real n_squared = n0 * n0 + n1 * n1 + n2 * n2, n_scale = 1 / std::sqrt(n_squared);
        nx[i] = n0 * n_scale, ny[i] = n1 * n_scale, nz[i] = n2 * n_scale;
        squared[i] = n_squared;
        const Real x0 = row[4] * inverse, x1 = row[5] * inverse, x2 = row[6] * inverse;
        xx[i] = x0, xy[i] = x1, xz[i] = x2;
        if constexpr (!View) continue;
        const Real v0 = eye.x - x0, v1 = eye.y - x1, v2 = eye.z - x2;
        const Real v_scale = 1 / std::sqrt(v0 * v0 + v1 * v1 + v2 * v2);
        vx[i] = v0 * v_scale, vy[i] = v1 * v_scale, vz[i] = v2 * v_scale;
    }
}

template <class Real>
void transform(const Real (*m)[4], const glm::vec3& p, bool point, Real* __restrict out) {
    const Real x = p.x, y = p.y, z = p.z;
    for (int k = 0; k < 4; ++k) {
        out[k] = m[0][k] * x + m[1][k] * y + m[2][k] * z;
        if (point) out[k] += m[3][k];
    }
}

/// The perspective weight of the corner opposite to the edge from a to b, as a plane over the pixels about the anchor: the cross
/// product of their homogeneous coordinates (Olano & Greer 1997). The unclipped triangle's corners serve clipped pieces as well.
template <class Real>
struct Weight {
    Real c, x, y;
};

template <class Real>
Weight<Real> weight(const Real (&a)[3], const Real (&b)[3]) {
    return {a[0] * b[1] - a[1] * b[0], a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2]};
}

/// Eight attributes at once.
template <class Real>
struct RowOf {
    typedef Real type __attribute__((vector_size(8 * sizeof(Real))));
};
template <class Real>
using Row = typename RowOf<Real>::type;

template <class Real>
void blend(const Weight<Real> (&w)[3], const Real* row0, const Real* row1, const Real* row2, Planes<Real>& out) {
    const auto r0 = load<Row<Real>>(row0), r1 = load<Row<Real>>(row1), r2 = load<Row<Real>>(row2);
    store(out.c, r0 * w[0].c + r1 * w[1].c + r2 * w[2].c);
    store(out.x, r0 * w[0].x + r1 * w[1].x + r2 * w[2].x);
    store(out.y, r0 * w[0].y + r1 * w[1].y + r2 * w[2].y);
}

}  // namespace

template <class Real>
Corner<Real> corner(const DrawnObject<Real>& object, uint32_t vertex) {
    Corner<Real> out;
    transform(object.pixel_from_object, object.mesh->positions[vertex], true, out.pixel);
    transform(object.normal_from_object, object.mesh->normals[vertex], false, out.row);
    transform(object.world_from_object, object.mesh->positions[vertex], true, out.row + 4);
    if (!object.unit_normals) {
        Real* n = out.row;
        const Real scale = 1 / std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        n[0] *= scale, n[1] *= scale, n[2] *= scale;
    }
    out.row[3] = 1;
    out.row[7] = 0;
    return out;
}

double exact_depth(const DrawnObject<double>& object, uint32_t triangle, double x, double y) {
    double at[3][3], z[3], w[3];
    for (int k = 0; k < 3; ++k) {
        const Corner<double> c = corner(object, object.mesh->indices[3 * size_t(triangle) + size_t(k)]);
        at[k][0] = c.pixel[0] - c.pixel[2] * x, at[k][1] = c.pixel[1] - c.pixel[2] * y, at[k][2] = c.pixel[2];
        w[k] = c.pixel[2], z[k] = c.pixel[3];
    }
    const double b0 = weight(at[1], at[2]).c, b1 = weight(at[2], at[0]).c, b2 = weight(at[0], at[1]).c;
    const double depth = 0.5 * (b0 * z[0] + b1 * z[1] + b2 * z[2]) / (b0 * w[0] + b1 * w[1] + b2 * w[2]) + 0.5;
    // Seen edge-on there is no plane; the nearest corner is as good as any.
    return depth == depth ? std::clamp(depth, 0.0, 1.0) : 0.5 * std::min({z[0] / w[0], z[1] / w[1], z[2] / w[2]}) + 0.5;
}

template <class Real>
void Interpolator<Real>::begin_tile(const TileView& view, glm::ivec2 origin) {
    view_ = &view;
    origin_ = origin;
    slots_.assign(view.triangles.size(), no_slot);
    planes_.clear();
    colour_planes_.clear();
}

/// Sets up the planes of the fragment's triangle about the fragment's pixel; returns where they stand.
template <class Real>
uint32_t Interpolator<Real>::make_planes(const DrawnObject<Real>& object, const Fragment& fragment) {
    const uint32_t slot = uint32_t(planes_.size());
    const uint32_t* vertex =
        &object.mesh->indices[3 * size_t(view_->triangles[fragment.place] - object.first_triangle)];
    const Corner<Real> corners[3] = {corner(object, vertex[0]), corner(object, vertex[1]), corner(object, vertex[2])};
    const double centre_x = origin_.x + fragment.x + 0.5, centre_y = origin_.y + fragment.y + 0.5;
    // Only ratios of w matter; its size is taken out because its square would overflow for far triangles.
    const double w_scale =
        1 / std::max({std::abs(corners[0].pixel[2]), std::abs(corners[1].pixel[2]), std::abs(corners[2].pixel[2])});
    Real at[3][3];
    for (int k = 0; k < 3; ++k) {
        const double w = corners[k].pixel[2] * w_scale;
        at[k][0] = Real(corners[k].pixel[0] * w_scale - w * centre_x);
        at[k][1] = Real(corners[k].pixel[1] * w_scale - w * centre_y);
        at[k][2] = Real(w);
    }
    Weight<Real> weights[3] = {weight(at[1], at[2]), weight(at[2], at[0]), weight(at[0], at[1])};
    // Only a triangle seen exactly edge-on has sum 0; no sample of it is covered but by rounding.
    if (!(weights[0].c + weights[1].c + weights[2].c != 0)) std::fill_n(weights, 3, Weight<Real>{Real(1) / 3, 0, 0});
    planes_.emplace_back();
    planes_.back().anchor_x = fragment.x;
    planes_.back().anchor_y = fragment.y;
    blend(weights, corners[0].row, corners[1].row, corners[2].row, planes_.back());
    if (!object.colour.empty()) {
        Real rows[3][16] = {};
        for (int k = 0; k < 3; ++k) std::copy_n(object.colour[vertex[k]].begin(), 12, rows[k]);
        colour_planes_.resize(2 * planes_.size());
        for (int half = 0; half < 2; ++half)
            blend(weights, rows[0] + 8 * half, rows[1] + 8 * half, rows[2] + 8 * half,
                  colour_planes_[2 * slot + size_t(half)]);
    }
    return slot;
}

template <class Real>
int64_t Interpolator<Real>::interpolate(const DrawnObject<Real>& object, const Fragment* fragments, int count,
                                        FragmentBatch<Real>& batch) {
    rows_.resize(8 * size_t(FragmentBatch<Real>::capacity));
    squared_.resize(size_t(FragmentBatch<Real>::capacity));
    batch.count = count;
    const int width = frame_.film.width, first = (frame_.film.height - 1 - origin_.y) * width + origin_.x;
    const bool coloured = !object.colour.empty();
    for (int i = 0; i < count; ++i) {
        const Fragment fragment = fragments[i];
        batch.pixel[i] = first - fragment.y * width + fragment.x;
        batch.weight[i] = fragment.weight;
        uint32_t slot = slots_[fragment.place];
        if (slot == no_slot) slots_[fragment.place] = slot = make_planes(object, fragment);
        const Planes<Real>& planes = planes_[slot];
        const Real dx = Real(fragment.x - planes.anchor_x), dy = Real(fragment.y - planes.anchor_y);
        const Row<Real> row =
            load<Row<Real>>(planes.c) + load<Row<Real>>(planes.x) * dx + load<Row<Real>>(planes.y) * dy;
        store(&rows_[8 * size_t(i)], row);
        if (!coloured) continue;
        for (int k = 0; k < frame_.layers_out; ++k) {
            const Planes<Real>& colour = colour_planes_[2 * slot + size_t(k / 8)];
            batch.out[k][i] = (colour.c[k % 8] + colour.x[k % 8] * dx + colour.y[k % 8] * dy) / row[3];
        }
    }
    return coloured && !frame_.features.surface ? 0 : surface(object, fragments, batch, frame_.features.view);
}

/// The batch's normals, positions and views, from its rows.
template <class Real>
int64_t Interpolator<Real>::surface(const DrawnObject<Real>& object, const Fragment* fragments,
                                    FragmentBatch<Real>& batch, bool view) {
    auto &n = batch.normal, &x = batch.position, &v = batch.eye;
    (view ? finish<true, Real> : finish<false, Real>)(batch.count, rows_.data(), frame_.eye, n[0], n[1], n[2], x[0],
                                                      x[1], x[2], v[0], v[1], v[2], squared_.data());
    if (!object.normals_can_cancel) return 0;

    // Where vertex normals cancel the direction is noise: the face normal stands in, counted.
    int64_t replaced = 0;
    for (int i = 0; i < batch.count; ++i) {
        if (squared_[size_t(i)] >= Real(1e-8)) continue;
        ++replaced;
        const uint32_t triangle = view_->triangles[fragments[i].place] - object.first_triangle;
        glm::vec<3, Real> p[3];
        for (int k = 0; k < 3; ++k)
            p[k] = corner(object, object.mesh->indices[3 * size_t(triangle) + size_t(k)]).position();
        const glm::vec<3, Real> face = object.orientation * glm::normalize(glm::cross(p[1] - p[0], p[2] - p[0]));
        for (int k = 0; k < 3; ++k) n[k][i] = face[k];
    }
    return replaced;
}

template Corner<float> corner(const DrawnObject<float>&, uint32_t);
template Corner<double> corner(const DrawnObject<double>&, uint32_t);
template class Interpolator<float>;
template class Interpolator<double>;

}  // namespace shadelab
