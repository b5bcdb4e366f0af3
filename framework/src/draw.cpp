// Stages 1, 3, 5 and 6: vertices to clip space, triangles to tiles, visible fragments to the student's function and the film.
#include <shadelab/pipeline.hpp>

#include "clones.hpp"
#include "rasterize.hpp"

#include <omp.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <memory>

namespace shadelab {

namespace {

double now_ms() {
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// Everything about one object that stages 5 and 6 ask for.
template <class Real>
struct DrawnObject {
    const Object* object;
    const Mesh* mesh;
    VertexStream<Real> vertices;
    uint32_t first_triangle;  ///< number of its triangle 0 in the scene
    Real orientation;         ///< -1 when to_world mirrors
    bool normals_can_cancel;
    const plugin::Model<Real>* model;
    std::vector<Real> material;
    std::vector<glm::vec<3, Real>> lights_within;  ///< positions of the lights inside of its bounding box
};

template <class Real>
struct Frame {
    const Scene& scene;
    const Features& features;
    const plugin::Table<Real>& plugin;
    Film& film;
    std::vector<DrawnObject<Real>> objects;
    std::vector<std::vector<Real>> lights;  ///< flattened, in the order of features.lights
    glm::vec<3, Real> eye;
    int layers_out;  ///< 3 (total) or 12 (with the terms)

    const DrawnObject<Real>& object_of(uint32_t triangle) const {
        auto after =
            std::upper_bound(objects.begin(), objects.end(), triangle,
                             [](uint32_t t, const DrawnObject<Real>& object) { return t < object.first_triangle; });
        return *(after - 1);
    }
};

/// Adds every light's contribution to the batch's out arrays, one light at a time. Returns how often a light stands at the very
/// point that it should light: it has no direction there, and functions are to give 0.
template <class Real>
int64_t shade(const Frame<Real>& frame, const DrawnObject<Real>& object, FragmentBatch<Real>& batch) {
    for (int k = 0; k < frame.layers_out; ++k) std::fill(batch.out[k], batch.out[k] + batch.count, Real(0));
    plugin::Batch<Real> arguments{batch.count, {}, {}};
    for (int k = 0; k < 9; ++k) arguments.in[k] = batch.in[k];
    for (int k = 0; k < 12; ++k) arguments.out[k] = batch.out[k];
    for (const std::vector<Real>& light : frame.lights)
        object.model->shade[int(light[0])](arguments, object.material.data(), light.data());
    int64_t at_surface = 0;
    for (const glm::vec<3, Real>& light : object.lights_within)
        for (int i = 0; i < batch.count; ++i)
            at_surface += (batch.in[3][i] == light.x) & (batch.in[4][i] == light.y) & (batch.in[5][i] == light.z);
    return at_surface;
}

// ---------------------------------------------------------------------------------------------- stage 1: vertices

/// M (x, y, z, 1) in float32, products added column by column and nothing fused: the order in which llvmpipe adds them.
glm::vec4 transform(const glm::mat4& m, glm::vec3 p) { return ((m[0] * p.x + m[1] * p.y) + m[2] * p.z) + m[3]; }

template <class Real>
DrawnObject<Real> prepare_object(const Frame<Real>& frame, const Object& object, const Mesh& mesh,
                                 const glm::dmat4& world_to_clip, uint32_t first_triangle) {
    using vec3 = glm::vec<3, Real>;
    DrawnObject<Real> drawn{&object, &mesh, {}, first_triangle, Real(1), false, nullptr, {}, {}};
    const glm::dmat4 object_to_clip = world_to_clip * object.to_world;
    const glm::dmat3 linear(object.to_world);
    const glm::mat4 clip_matrix(object_to_clip);
    const glm::mat<4, 4, Real> world_matrix(object.to_world);
    const glm::mat<3, 3, Real> normal_matrix(glm::transpose(glm::inverse(linear)));
    drawn.orientation = Real(glm::determinant(linear) < 0 ? -1 : 1);
    drawn.normals_can_cancel = normals_can_cancel(mesh, object.to_world);

    const int count = int(mesh.positions.size());
    VertexStream<Real>& out = drawn.vertices;
    out.clip.resize(count);
    out.homogeneous.resize(count);
    out.position.resize(count);
    out.normal.resize(count);
    const Real half_width = Real(frame.film.width) / 2, half_height = Real(frame.film.height) / 2;
#pragma omp parallel for schedule(static)
    for (int i = 0; i < count; ++i) {
        const glm::vec3 p = mesh.positions[i];
        out.clip[i] = transform(clip_matrix, p);
        glm::vec<4, Real> clip(out.clip[i]);
        if constexpr (std::is_same_v<Real, double>) clip = object_to_clip * glm::dvec4(p, 1);
        out.homogeneous[i] = {(clip.x + clip.w) * half_width, (clip.y + clip.w) * half_height, clip.z, clip.w};
        out.position[i] = vec3(world_matrix * glm::vec<4, Real>(vec3(p), Real(1)));
        out.normal[i] = glm::normalize(normal_matrix * vec3(mesh.normals[i]));
    }

    vec3 low(std::numeric_limits<Real>::infinity()), high = -low;
    for (const vec3& x : out.position) low = glm::min(low, x), high = glm::max(high, x);
    for (const std::vector<Real>& light : frame.lights)
        if (const vec3 x(light[1], light[2], light[3]); LightKind(int(light[0])) != LightKind::directional)
            if (glm::all(glm::lessThanEqual(low, x)) && glm::all(glm::lessThanEqual(x, high)))
                drawn.lights_within.push_back(x);

    const Material& material = frame.scene.materials[object.material];
    for (int k = 0; k < frame.plugin.model_count; ++k)
        if (material.model == frame.plugin.models[k].name) drawn.model = &frame.plugin.models[k];
    drawn.material.assign(material.parameters.begin(), material.parameters.end());
    return drawn;
}

/// Gouraud: the student's function is evaluated at the vertices, its colours are interpolated later.
template <class Real>
void shade_vertices(const Frame<Real>& frame, DrawnObject<Real>& object, int64_t& lights_at_surface) {
    VertexStream<Real>& vertices = object.vertices;
    const int count = int(vertices.position.size()), capacity = FragmentBatch<Real>::capacity;
    vertices.colour.resize(count);
    int64_t at_surface = 0;
#pragma omp parallel reduction(+ : at_surface)
    {
        auto batch = std::make_unique<FragmentBatch<Real>>();
#pragma omp for schedule(dynamic)
        for (int start = 0; start < count; start += capacity) {
            batch->count = std::min(capacity, count - start);
            for (int i = 0; i < batch->count; ++i) {
                const glm::vec<3, Real> x = vertices.position[start + i], v = glm::normalize(frame.eye - x);
                for (int k = 0; k < 3; ++k) {
                    batch->in[k][i] = vertices.normal[start + i][k];
                    batch->in[3 + k][i] = x[k];
                    batch->in[6 + k][i] = v[k];
                }
            }
            at_surface += shade(frame, object, *batch);
            for (int i = 0; i < batch->count; ++i)
                for (int k = 0; k < frame.layers_out; ++k) vertices.colour[start + i][k] = batch->out[k][i];
        }
    }
    lights_at_surface += at_surface;
}

// ---------------------------------------------------------------------------------------------- stages 2 and 3: bins

/// The triangles of one stretch of the scene, listed by tile. Stretches are fixed and visited in order, so that the order of
/// equal depths, and with it the image, does not depend on the number of threads.
struct BinnedStretch {
    std::vector<ScreenTriangle> triangles;
    std::vector<std::vector<uint32_t>> bins;
};

struct TileGrid {
    int width, height, across, down;
    TileGrid(int width, int height)
        : width(width),
          height(height),
          across((width + tile_size - 1) / tile_size),
          down((height + tile_size - 1) / tile_size) {}
};

void bin_triangle(const ScreenTriangle& t, const TileGrid& grid, int margin, BinnedStretch& stretch) {
    const ScreenVertex &a = t.vertex[0], &b = t.vertex[1], &c = t.vertex[2];
    if (int64_t(b.x - a.x) * (c.y - a.y) == int64_t(c.x - a.x) * (b.y - a.y))
        return;  // no area on the grid: covers no sample
    // The pixels whose samples (at most `margin` sub-pixels off their centres) the bounding box can hold.
    const int x0 = std::max((std::min({a.x, b.x, c.x}) - margin + 255) >> subpixel_bits, 0);
    const int x1 = std::min((std::max({a.x, b.x, c.x}) + margin) >> subpixel_bits, grid.width - 1);
    const int y0 = std::max((std::min({a.y, b.y, c.y}) - margin + 255) >> subpixel_bits, 0);
    const int y1 = std::min((std::max({a.y, b.y, c.y}) + margin) >> subpixel_bits, grid.height - 1);
    if (x0 > x1 || y0 > y1) return;
    const uint32_t index = uint32_t(stretch.triangles.size());
    stretch.triangles.push_back(t);
    for (int y = y0 / tile_size; y <= y1 / tile_size; ++y)
        for (int x = x0 / tile_size; x <= x1 / tile_size; ++x)
            stretch.bins[size_t(y) * grid.across + x].push_back(index);
}

template <class Real>
std::vector<BinnedStretch> bin_scene(const Frame<Real>& frame, const TileGrid& grid, int margin,
                                     DrawStatistics& statistics) {
    struct Stretch {
        const DrawnObject<Real>* object;
        size_t begin, end;
    };
    constexpr size_t stretch_length = 16384;
    std::vector<Stretch> stretches;
    std::vector<std::vector<ScreenVertex>> screen(frame.objects.size());
    std::vector<std::vector<uint16_t>> codes(frame.objects.size());
    for (size_t o = 0; o < frame.objects.size(); ++o) {
        const std::vector<glm::vec4>& clip = frame.objects[o].vertices.clip;
        const int count = int(clip.size());
        screen[o].resize(count);
        codes[o].resize(count);
        int64_t not_finite = 0;
#pragma omp parallel for schedule(static) reduction(+ : not_finite)
        for (int i = 0; i < count; ++i) {
            codes[o][i] = uint16_t(clip_code(clip[i], grid.width, grid.height));
            not_finite += (codes[o][i] & clip_not_finite) != 0;
            if (!(codes[o][i] & (must_clip | clip_not_finite)))
                screen[o][i] = project(clip[i], grid.width, grid.height);
        }
        statistics.not_finite_vertices += not_finite;
        const size_t triangles = frame.objects[o].mesh->triangle_count();
        statistics.triangles += int64_t(triangles);
        for (size_t begin = 0; begin < triangles; begin += stretch_length)
            stretches.push_back({&frame.objects[o], begin, std::min(begin + stretch_length, triangles)});
    }

    std::vector<BinnedStretch> out(stretches.size());
    int64_t clipped = 0;
#pragma omp parallel for schedule(dynamic) reduction(+ : clipped)
    for (int s = 0; s < int(stretches.size()); ++s) {
        const Stretch& stretch = stretches[s];
        const size_t o = size_t(stretch.object - frame.objects.data());
        const std::vector<uint32_t>& indices = stretch.object->mesh->indices;
        out[s].bins.resize(size_t(grid.across) * grid.down);
        std::vector<ScreenTriangle> pieces;
        for (size_t t = stretch.begin; t < stretch.end; ++t) {
            const uint32_t* corner = &indices[3 * t];
            const unsigned a = codes[o][corner[0]], b = codes[o][corner[1]], c = codes[o][corner[2]];
            if ((a & b & c) != 0 || ((a | b | c) & clip_not_finite) != 0) continue;
            const uint32_t number = stretch.object->first_triangle + uint32_t(t);
            if (((a | b | c) & must_clip) == 0) {
                bin_triangle({{screen[o][corner[0]], screen[o][corner[1]], screen[o][corner[2]]}, number}, grid, margin,
                             out[s]);
                continue;
            }
            ++clipped;
            const std::vector<glm::vec4>& clip = stretch.object->vertices.clip;
            const glm::vec4 corners[3] = {clip[corner[0]], clip[corner[1]], clip[corner[2]]};
            pieces.clear();
            clip_and_project(corners, grid.width, grid.height, number, pieces);
            for (const ScreenTriangle& piece : pieces) bin_triangle(piece, grid, margin, out[s]);
        }
    }
    statistics.clipped_triangles += clipped;
    return out;
}

// ---------------------------------------------------------------------------------------------- stage 5: fragments

struct Fragment {
    int x, y;  ///< window pixel, y upwards
    uint32_t triangle;
    float weight;
};

/// The distinct triangles that each pixel of a tile sees, with the share of its samples. Row by row.
void collect_fragments(const VisibilityTile& tile, int samples, glm::ivec2 origin, const TileGrid& grid,
                       std::vector<Fragment>& out) {
    out.clear();
    const int width = std::min(tile_size, grid.width - origin.x), height = std::min(tile_size, grid.height - origin.y);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const size_t first_of_pixel = out.size();
            for (int s = 0; s < samples; ++s) {
                const uint32_t triangle = tile.triangle[(size_t(s) * tile_size + y) * tile_size + x];
                if (triangle == no_triangle) continue;
                size_t i = first_of_pixel;
                while (i < out.size() && out[i].triangle != triangle) ++i;
                if (i == out.size()) out.push_back({origin.x + x, origin.y + y, triangle, 0});
                out[i].weight += 1.0f / float(samples);
            }
        }
}

/// Perspective-correct weights of a triangle's corners at the centre of pixel (x, y), normalised to sum 1. They come from the
/// unclipped triangle's homogeneous coordinates (Olano & Greer 1997), so clipped pieces need no vertices of their own.
template <class Real>
glm::vec<3, Real> corner_weights(const DrawnObject<Real>& object, const uint32_t* corner, int x, int y) {
    const glm::vec<4, Real>&p0 = object.vertices.homogeneous[corner[0]], &p1 = object.vertices.homogeneous[corner[1]],
                      &p2 = object.vertices.homogeneous[corner[2]];
    const Real cx = Real(x) + Real(0.5), cy = Real(y) + Real(0.5);
    const Real x0 = p0.x - p0.w * cx, x1 = p1.x - p1.w * cx, x2 = p2.x - p2.w * cx;
    const Real y0 = p0.y - p0.w * cy, y1 = p1.y - p1.w * cy, y2 = p2.y - p2.w * cy;
    const Real b0 = x1 * y2 - x2 * y1, b1 = x2 * y0 - x0 * y2, b2 = x0 * y1 - x1 * y0;
    const Real sum = b0 + b1 + b2;
    // Only a triangle seen exactly edge-on has sum 0; no sample of it is covered but by rounding.
    return sum != 0 ? glm::vec<3, Real>(b0 / sum, b1 / sum, b2 / sum) : glm::vec<3, Real>(Real(1) / 3);
}

/// The unit normal at a fragment. Where vertex normals cancel the direction is noise: the face normal stands in, counted.
template <class Real>
glm::vec<3, Real> fragment_normal(const DrawnObject<Real>& object, const uint32_t* corner, glm::vec<3, Real> weights,
                                  int64_t& fallbacks) {
    using vec3 = glm::vec<3, Real>;
    const VertexStream<Real>& vertices = object.vertices;
    const vec3 n = weights.x * vertices.normal[corner[0]] + weights.y * vertices.normal[corner[1]] +
                   weights.z * vertices.normal[corner[2]];
    const Real squared = glm::dot(n, n);
    if (object.normals_can_cancel && !(squared >= Real(1e-8))) {
        ++fallbacks;
        const vec3 a = vertices.position[corner[0]];
        return object.orientation *
               glm::normalize(glm::cross(vertices.position[corner[1]] - a, vertices.position[corner[2]] - a));
    }
    return n * (1 / std::sqrt(squared));
}

template <class Real>
void interpolate(const Frame<Real>& frame, const DrawnObject<Real>& object, const Fragment* fragments,
                 FragmentBatch<Real>& batch, int64_t& fallbacks) {
    using vec3 = glm::vec<3, Real>;
    const VertexStream<Real>& vertices = object.vertices;
    for (int i = 0; i < batch.count; ++i) {
        const Fragment& fragment = fragments[i];
        const uint32_t* corner = &object.mesh->indices[3 * size_t(fragment.triangle - object.first_triangle)];
        const vec3 weights = corner_weights(object, corner, fragment.x, fragment.y);
        batch.pixel[i] = (frame.film.height - 1 - fragment.y) * frame.film.width + fragment.x;
        batch.weight[i] = fragment.weight;
        const vec3 n = fragment_normal(object, corner, weights, fallbacks);
        const vec3 x = weights.x * vertices.position[corner[0]] + weights.y * vertices.position[corner[1]] +
                       weights.z * vertices.position[corner[2]];
        const vec3 v = glm::normalize(frame.eye - x);
        for (int k = 0; k < 3; ++k) {
            batch.in[k][i] = n[k];
            batch.in[3 + k][i] = x[k];
            batch.in[6 + k][i] = v[k];
        }
        if (!vertices.colour.empty())
            for (int k = 0; k < frame.layers_out; ++k)
                batch.out[k][i] = weights.x * vertices.colour[corner[0]][k] +
                                  weights.y * vertices.colour[corner[1]][k] + weights.z * vertices.colour[corner[2]][k];
    }
}

// ---------------------------------------------------------------------------------------------- stage 6: film

template <class Real>
void write_colours(const Frame<Real>& frame, const DrawnObject<Real>& object, const FragmentBatch<Real>& batch,
                   DrawStatistics& statistics) {
    Film& film = frame.film;
    const glm::vec3 background(frame.scene.film.background);
    for (int i = 0; i < batch.count; ++i) {
        const glm::vec<3, Real> value(batch.out[0][i], batch.out[1][i], batch.out[2][i]);
        float* total = film.layers[0].pixel(batch.pixel[i]);
        for (int c = 0; c < 3; ++c) {
            if (batch.weight[i] == 1)
                total[c] = float(value[c]);
            else
                total[c] += batch.weight[i] * (float(value[c]) - background[c]);
        }
        if (!(std::isfinite(value.x) && std::isfinite(value.y) && std::isfinite(value.z))) {
            ++statistics.not_finite_fragments;
            const int x = batch.pixel[i] % film.width, y = batch.pixel[i] / film.width;
            if (!statistics.first_not_finite ||
                std::pair(y, x) < std::pair(statistics.first_not_finite->y, statistics.first_not_finite->x)) {
                const auto in = [&](int k) {
                    return glm::dvec3(batch.in[k][i], batch.in[k + 1][i], batch.in[k + 2][i]);
                };
                const Material& material = frame.scene.materials[object.object->material];
                statistics.first_not_finite = {x,     y,     material.name, material.model,
                                               in(0), in(3), in(6),         glm::dvec3(value)};
            }
        }
    }
    if (!frame.features.term_layers) return;
    for (int layer = 1; layer <= 3; ++layer)
        for (int i = 0; i < batch.count; ++i)
            for (int c = 0; c < 3; ++c)
                film.layers[layer].pixel(batch.pixel[i])[c] += batch.weight[i] * float(batch.out[3 * layer + c][i]);
    for (int i = 0; i < batch.count; ++i) film.layers[4].data[batch.pixel[i]] += batch.weight[i];
}

template <class Real>
void write_geometry(const Frame<Real>& frame, const DrawnObject<Real>& object, const VisibilityTile& tile,
                    const Fragment* fragments, glm::ivec2 origin, const FragmentBatch<Real>& batch) {
    Layer &id = *frame.film.find("id"), &depth = *frame.film.find("depth"), &normal = *frame.film.find("normal"),
          &position = *frame.film.find("position");
    for (int i = 0; i < batch.count; ++i) {
        const size_t pixel = size_t(batch.pixel[i]);
        id.data[pixel] = float(object.object - frame.scene.objects.data() + 1);
        depth.data[pixel] = tile.depth[size_t(fragments[i].y - origin.y) * tile_size + fragments[i].x - origin.x];
        for (int c = 0; c < 3; ++c) {
            normal.pixel(pixel)[c] = float(batch.in[c][i]);
            position.pixel(pixel)[c] = float(batch.in[3 + c][i]);
        }
    }
}

/// Calls visit(object, fragments, count) for runs of at most a batch of fragments of one object.
template <class Real, class Visit>
void for_each_batch(const Frame<Real>& frame, std::vector<Fragment>& fragments, Visit visit) {
    if (frame.objects.size() > 1)
        std::stable_sort(fragments.begin(), fragments.end(), [&](const Fragment& a, const Fragment& b) {
            return &frame.object_of(a.triangle) < &frame.object_of(b.triangle);
        });
    for (size_t begin = 0; begin < fragments.size();) {
        const DrawnObject<Real>& object = frame.object_of(fragments[begin].triangle);
        const uint32_t end_triangle = object.first_triangle + uint32_t(object.mesh->triangle_count());
        size_t end = begin;
        while (end < fragments.size() && end - begin < size_t(FragmentBatch<Real>::capacity) &&
               fragments[end].triangle < end_triangle)
            ++end;
        visit(object, &fragments[begin], int(end - begin));
        begin = end;
    }
}

void merge(DrawStatistics& into, const DrawStatistics& from) {
    into.fragments += from.fragments;
    into.fallback_normals += from.fallback_normals;
    into.lights_at_surface += from.lights_at_surface;
    into.not_finite_fragments += from.not_finite_fragments;
    const auto& a = from.first_not_finite;
    const auto& b = into.first_not_finite;
    if (a && (!b || std::pair(a->y, a->x) < std::pair(b->y, b->x))) into.first_not_finite = a;
}

}  // namespace

template <class Real>
DrawStatistics draw(const Scene& scene, const Features& features, const std::vector<Mesh>& meshes,
                    const plugin::Table<Real>& plugin, Film& film) {
    DrawStatistics statistics;
    const double start = now_ms();
    Frame<Real> frame{
        scene, features, plugin, film, {}, {}, glm::vec<3, Real>(scene.camera.eye), plugin.terms ? 12 : 3};
    for (int i : features.lights) {
        const std::vector<double> light = scene.lights[i].flatten();
        frame.lights.emplace_back(light.begin(), light.end());
    }
    const glm::dmat4 world_to_clip = scene.camera.world_to_clip(double(film.width) / film.height);
    uint32_t triangle_count = 0;
    for (size_t i = 0; i < scene.objects.size(); ++i) {
        frame.objects.push_back(prepare_object(frame, scene.objects[i], meshes[i], world_to_clip, triangle_count));
        triangle_count += uint32_t(meshes[i].triangle_count());
    }
    for (DrawnObject<Real>& object : frame.objects)
        if (object.object->interpolation == Interpolation::gouraud)
            shade_vertices(frame, object, statistics.lights_at_surface);
    const double vertices_done = now_ms();

    const TileGrid grid(film.width, film.height);
    const int samples = scene.film.samples;
    const std::vector<BinnedStretch> stretches = bin_scene(frame, grid, samples > 1 ? 128 : 0, statistics);
    const double bins_done = now_ms();

#pragma omp parallel
    {
        DrawStatistics mine;
        VisibilityTile tile;
        std::vector<Fragment> fragments;
        auto batch = std::make_unique<FragmentBatch<Real>>();
        const auto see = [&](int index, glm::ivec2 origin, int sample_count) {
            tile.depth.assign(size_t(sample_count) * tile_size * tile_size, 1.0f);
            tile.triangle.assign(size_t(sample_count) * tile_size * tile_size, no_triangle);
            for (const BinnedStretch& stretch : stretches)
                rasterize_list(stretch.triangles.data(), stretch.bins[index].data(), stretch.bins[index].size(), origin,
                               sample_count, tile);
            collect_fragments(tile, sample_count, origin, grid, fragments);
        };
#pragma omp for schedule(dynamic)
        for (int index = 0; index < grid.across * grid.down; ++index) {
            const glm::ivec2 origin(index % grid.across * tile_size, index / grid.across * tile_size);
            const bool anything = std::any_of(stretches.begin(), stretches.end(),
                                              [&](const BinnedStretch& s) { return !s.bins[index].empty(); });
            if (!anything) continue;
            see(index, origin, samples);
            for_each_batch(frame, fragments, [&](const DrawnObject<Real>& object, const Fragment* run, int count) {
                batch->count = count;
                interpolate(frame, object, run, *batch, mine.fallback_normals);
                if (object.vertices.colour.empty()) mine.lights_at_surface += shade(frame, object, *batch);
                write_colours(frame, object, *batch, mine);
                if (features.geometry_layers && samples == 1) write_geometry(frame, object, tile, run, origin, *batch);
                mine.fragments += count;
            });
            if (!features.geometry_layers || samples == 1) continue;
            see(index, origin, 1);  // geometry layers show the surface at the pixel's centre
            for_each_batch(frame, fragments, [&](const DrawnObject<Real>& object, const Fragment* run, int count) {
                int64_t ignored = 0;
                batch->count = count;
                interpolate(frame, object, run, *batch, ignored);
                write_geometry(frame, object, tile, run, origin, *batch);
            });
        }
#pragma omp critical
        merge(statistics, mine);
    }
    statistics.vertex_ms = vertices_done - start;
    statistics.bin_ms = bins_done - vertices_done;
    statistics.tile_ms = now_ms() - bins_done;
    return statistics;
}

template DrawStatistics draw<float>(const Scene&, const Features&, const std::vector<Mesh>&,
                                    const plugin::Table<float>&, Film&);
template DrawStatistics draw<double>(const Scene&, const Features&, const std::vector<Mesh>&,
                                     const plugin::Table<double>&, Film&);

}  // namespace shadelab
