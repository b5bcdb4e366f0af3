// The frame as a whole, and stage 6: the student's function and the film.
#include "frame/levels.hpp"
#include "raster/rasterize.hpp"
#include "raster/stages.hpp"

#include <shadelab/error.hpp>

#include <omp.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <memory>

namespace shadelab {

namespace {

constexpr size_t most_columns = 64;  // that a model takes

double now_ms() {
    return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// ---------------------------------------------------------------------------------------------- objects

/// Where the array stands that a model names: "n.x", or "m.kd.x", of which `constants` gets one with the material's value. (No
/// texture gives another one yet.)
template <class Real>
BatchColumn find_column(const Frame<Real>& frame, const Material& material, const std::string& name,
                        std::vector<Real>& constants) {
    for (size_t k = 0; k < material.columns.size(); ++k)
        if (name == material.columns[k]) {
            constants.insert(constants.end(), FragmentBatch<Real>::capacity, Real(material.parameters[k]));
            return {BatchColumn::material, int(constants.size()) / FragmentBatch<Real>::capacity - 1};
        }
    const size_t dot = name.find('.');
    const int component = dot == std::string::npos ? 0 : int(std::string("xyzw").find(name[dot + 1]));
    for (const FragmentAttribute& attribute : frame.features.attributes)
        if (attribute.name == name.substr(0, dot))
            return {attribute.source == "normal"     ? BatchColumn::normal
                    : attribute.source == "position" ? BatchColumn::position
                                                     : BatchColumn::eye,
                    component};
    throw InfrastructureError("the plugin's model takes " + name + ", which no fragment holds; build it again");
}

template <class Real>
DrawnObject<Real> prepare_object(const Frame<Real>& frame, const Object& object, const Mesh& mesh,
                                 const FrameFacts& facts, uint32_t first_vertex, uint32_t first_triangle) {
    using vec3 = glm::vec<3, Real>;
    DrawnObject<Real> drawn{};
    drawn.object = &object;
    drawn.mesh = &mesh;
    drawn.first_vertex = first_vertex;
    drawn.first_triangle = first_triangle;
    const glm::dmat4 clip = facts.world_to_clip * object.to_world;
    const glm::dmat3 linear(object.to_world), gram = glm::transpose(linear) * linear;
    drawn.clip_from_object = glm::mat4(clip);
    drawn.orientation = Real(glm::determinant(linear) < 0 ? -1 : 1);
    drawn.normals_can_cancel = facts.normals_can_cancel[frame.objects.size()];

    glm::dmat3 normals = glm::transpose(glm::inverse(linear));
    const double scale = gram[0][0];  // of a similarity: its factor, squared
    double off = 0;
    for (int c = 0; c < 3; ++c)
        for (int r = 0; r < 3; ++r) off = std::max(off, std::abs(gram[c][r] - (c == r ? scale : 0)));
    drawn.unit_normals = off <= 1e-12 * scale;
    if (drawn.unit_normals) normals *= std::sqrt(scale);
    for (int c = 0; c < 4; ++c) {
        drawn.pixel_from_object[c][0] = (clip[c].x + clip[c].w) * (frame.film.width * 0.5);
        drawn.pixel_from_object[c][1] = (clip[c].y + clip[c].w) * (frame.film.height * 0.5);
        drawn.pixel_from_object[c][2] = clip[c].w;
        drawn.pixel_from_object[c][3] = clip[c].z;
        for (int r = 0; r < 4; ++r) drawn.world_from_object[c][r] = Real(object.to_world[c][r]);
        if (c < 3)
            for (int r = 0; r < 3; ++r) drawn.normal_from_object[c][r] = Real(normals[c][r]);
    }
    if (!frame.plugin) return drawn;

    // The box of the mesh's box holds the object.
    vec3 low(std::numeric_limits<Real>::infinity()), high = -low;
    for (int k = 0; k < 8; ++k) {
        const glm::dvec3 corner(k & 1 ? mesh.high.x : mesh.low.x, k & 2 ? mesh.high.y : mesh.low.y,
                                k & 4 ? mesh.high.z : mesh.low.z);
        const vec3 x(object.to_world * glm::dvec4(corner, 1));
        low = glm::min(low, x), high = glm::max(high, x);
    }
    for (const std::vector<Real>& light : frame.lights) {
        const vec3 x(light[1], light[2], light[3]);
        const bool outside = std::isfinite(mesh.low.x + mesh.high.x) &&  // a mesh made by hand may have no box
                             (glm::any(glm::lessThan(x, low)) || glm::any(glm::greaterThan(x, high)));
        if (facts.placed[size_t(&light - frame.lights.data())] && !outside) drawn.lights_within.push_back(x);
    }
    const Material& material = frame.scene.materials[object.material];
    for (int k = 0; k < frame.plugin->model_count; ++k)
        if (material.model == frame.plugin->models[k].name) drawn.model = &frame.plugin->models[k];
    drawn.material.assign(material.parameters.begin(), material.parameters.end());
    if (drawn.model && size_t(drawn.model->column_count) > most_columns)
        throw InfrastructureError(material.model + ": takes more columns than this program has room for");
    for (int k = 0; drawn.model && k < drawn.model->column_count; ++k)
        drawn.columns.push_back(find_column(frame, material, drawn.model->columns[k], drawn.constants));
    return drawn;
}

// ---------------------------------------------------------------------------------------------- stage 6: shading

/// Calls visit(object, fragments, count) for runs of at most a batch of fragments of one object.
template <class Real, class Visit>
void for_each_batch(const Frame<Real>& frame, const TileView& view, Fragments& fragments, Visit visit) {
    const auto range_of = [&](const Fragment& fragment) {
        return std::upper_bound(view.ranges.begin(), view.ranges.end(), fragment.place,
                                [](uint32_t place, const TileView::Range& range) { return place < range.first; }) -
               1;
    };
    if (view.ranges.size() > 1)
        std::stable_sort(
            fragments.list.begin(), fragments.list.begin() + int64_t(fragments.count),
            [&](const Fragment& a, const Fragment& b) { return range_of(a)->object < range_of(b)->object; });
    for (size_t begin = 0; begin < fragments.count;) {
        const uint32_t object = range_of(fragments.list[begin])->object;
        const size_t most = std::min(fragments.count, begin + size_t(FragmentBatch<Real>::capacity));
        size_t end = view.ranges.size() == 1 ? most : begin;
        while (end < most && range_of(fragments.list[end])->object == object) ++end;
        visit(frame.objects[object], &fragments.list[begin], int(end - begin));
        begin = end;
    }
}

/// Adds every light's contribution to the batch's out arrays, one light at a time. Returns how often a light stands at the very
/// point that it should light: it has no direction there, and functions are to give 0.
template <class Real>
int64_t shade(const Frame<Real>& frame, const DrawnObject<Real>& object, FragmentBatch<Real>& batch) {
    for (int k = 0; k < frame.layers_out; ++k) std::fill(batch.out[k], batch.out[k] + batch.count, Real(0));
    std::array<const Real*, most_columns> in;
    std::array<Real*, 12> out;
    for (size_t k = 0; k < object.columns.size(); ++k) {
        const auto [source, component] = object.columns[k];
        in[k] = source == BatchColumn::normal     ? batch.normal[component]
                : source == BatchColumn::position ? batch.position[component]
                : source == BatchColumn::eye ? batch.eye[component]
                                             : &object.constants[size_t(component * FragmentBatch<Real>::capacity)];
    }
    for (size_t k = 0; k < out.size(); ++k) out[k] = batch.out[k];
    const plugin::Batch<Real> arguments{batch.count, in.data(), out.data()};
    for (const std::vector<Real>& light : frame.lights)
        object.model->shade[int(light[0])](arguments, object.material.data(), light.data());
    int64_t at_surface = 0;
    for (const glm::vec<3, Real>& light : object.lights_within)
        for (int i = 0; i < batch.count; ++i)
            at_surface += (batch.position[0][i] == light.x) & (batch.position[1][i] == light.y) &
                          (batch.position[2][i] == light.z);
    return at_surface;
}

/// Gouraud: the student's function is evaluated at the vertices, its colours are interpolated later.
template <class Real>
void shade_vertices(const Frame<Real>& frame, DrawnObject<Real>& object, int64_t& lights_at_surface) {
    const int count = int(object.mesh->positions.size()), capacity = FragmentBatch<Real>::capacity;
    object.colour.resize(size_t(count));
    int64_t at_surface = 0;
#pragma omp parallel reduction(+ : at_surface)
    {
        auto batch = std::make_unique<FragmentBatch<Real>>();
#pragma omp for schedule(dynamic)
        for (int start = 0; start < count; start += capacity) {
            batch->count = std::min(capacity, count - start);
            for (int i = 0; i < batch->count; ++i) {
                const Corner<Real> vertex = corner(object, uint32_t(start + i));
                const glm::vec<3, Real> n = vertex.normal(), x = vertex.position(), v = glm::normalize(frame.eye - x);
                for (int k = 0; k < 3; ++k) {
                    batch->normal[k][i] = n[k];
                    batch->position[k][i] = x[k];
                    batch->eye[k][i] = v[k];
                }
            }
            at_surface += shade(frame, object, *batch);
            for (int i = 0; i < batch->count; ++i)
                for (int k = 0; k < frame.layers_out; ++k) object.colour[size_t(start + i)][k] = batch->out[k][i];
        }
    }
    lights_at_surface += at_surface;
}

// ---------------------------------------------------------------------------------------------- stage 6: film

/// The film's pixels under a tile as if nothing had been drawn.
void clear(Film& film, glm::ivec2 origin, glm::vec3 background) {
    const int right = std::min(origin.x + tile_size, film.width), top = std::min(origin.y + tile_size, film.height);
    for (Layer& layer : film.layers) {
        const bool coloured = layer.name == "total" && background != glm::vec3(0);
        const float value = layer.name.compare(0, 5, "depth") == 0 ? 1 : 0;  // 1: the far plane
        for (int y = origin.y; y < top; ++y) {
            const size_t row = size_t(film.height - 1 - y) * film.width;
            float *begin = layer.pixel(row + origin.x), *end = layer.pixel(row) + size_t(right) * layer.channels;
            if (coloured)
                for (float* p = begin; p < end; p += 3) std::copy_n(&background.x, 3, p);
            else
                std::fill(begin, end, value);
        }
    }
}

/// 0 when all values are finite, without a branch in the loop: infinity - infinity and NaN - NaN are NaN.
template <class Real>
bool all_finite(int count, const Real* __restrict r, const Real* __restrict g, const Real* __restrict b) {
    int bad = 0;
    for (int i = 0; i < count; ++i) {
        const Real sum = (r[i] - r[i]) + (g[i] - g[i]) + (b[i] - b[i]);
        bad |= sum == 0 ? 0 : 1;
    }
    return bad == 0;
}

/// Counts values that are not finite and keeps the topmost, then leftmost, with what went into it.
template <class Real>
void note_not_finite(const Frame<Real>& frame, const DrawnObject<Real>& object, const FragmentBatch<Real>& batch,
                     DrawStatistics& statistics) {
    for (int i = 0; i < batch.count; ++i) {
        const glm::vec<3, Real> value(batch.out[0][i], batch.out[1][i], batch.out[2][i]);
        if (std::isfinite(value.x) && std::isfinite(value.y) && std::isfinite(value.z)) continue;
        ++statistics.not_finite_fragments;
        const int x = batch.pixel[i] % frame.film.width, y = batch.pixel[i] / frame.film.width;
        if (statistics.first_not_finite &&
            std::pair(y, x) >= std::pair(statistics.first_not_finite->y, statistics.first_not_finite->x))
            continue;
        const auto at = [&](const auto& in) { return glm::dvec3(in[0][i], in[1][i], in[2][i]); };
        const Material& material = frame.scene.materials[object.object->material];
        statistics.first_not_finite = {x,
                                       y,
                                       material.name,
                                       material.model,
                                       at(batch.normal),
                                       at(batch.position),
                                       at(batch.eye),
                                       glm::dvec3(value)};
    }
}

template <class Real>
void write_colours(const Frame<Real>& frame, const FragmentBatch<Real>& batch) {
    Film& film = frame.film;
    const glm::vec3 background(frame.scene.film.background);
    float* total = film.layers[0].data.data();
    for (int i = 0; i < batch.count; ++i) {
        float* pixel = total + 3 * size_t(batch.pixel[i]);
        const float weight = batch.weight[i];
        for (int c = 0; c < 3; ++c) {
            const float value = float(batch.out[c][i]);
            pixel[c] = weight == 1 ? value : pixel[c] + weight * (value - background[c]);
        }
    }
    if (!frame.features.term_layers) return;
    for (int layer = 1; layer <= 3; ++layer)
        for (int i = 0; i < batch.count; ++i)
            for (int c = 0; c < 3; ++c) {
                float& pixel = film.layers[layer].pixel(batch.pixel[i])[c];
                const float value = float(batch.out[3 * layer + c][i]);
                pixel = batch.weight[i] == 1 ? value : pixel + batch.weight[i] * value;
            }
    for (int i = 0; i < batch.count; ++i) {
        float& coverage = film.layers[4].data[batch.pixel[i]];
        coverage = batch.weight[i] == 1 ? 1 : coverage + batch.weight[i];
    }
}

/// The depth at a sample of a fragment: the rasterizer's, or, for the reference, without its roundings.
template <class Real>
float depth_of(const DrawnObject<Real>& object, const TileView& view, const Fragment& fragment, glm::ivec2 origin,
               glm::ivec2 sample) {
    if constexpr (std::is_same_v<Real, double>)
        return float(exact_depth(object, view.triangles[fragment.place] - object.first_triangle,
                                 origin.x + fragment.x + 0.5 + sample.x / 256.0,
                                 origin.y + fragment.y + 0.5 + sample.y / 256.0));
    else
        return view.samples.depth[size_t(fragment.y) * tile_size + fragment.x];
}

template <class Real>
void write_geometry(const Frame<Real>& frame, const DrawnObject<Real>& object, const TileView& view, glm::ivec2 origin,
                    const Fragment* fragments, const FragmentBatch<Real>& batch) {
    Layer &id = *frame.film.find("id"), &depth = *frame.film.find("depth"), &normal = *frame.film.find("normal"),
          &position = *frame.film.find("position");
    for (int i = 0; i < batch.count; ++i) {
        const size_t pixel = size_t(batch.pixel[i]);
        id.data[pixel] = float(object.object - frame.scene.objects.data() + 1);
        depth.data[pixel] = depth_of(object, view, fragments[i], origin, glm::ivec2(0));
        for (int c = 0; c < 3; ++c) {
            normal.pixel(pixel)[c] = float(batch.normal[c][i]);
            position.pixel(pixel)[c] = float(batch.position[c][i]);
        }
    }
}

// ---------------------------------------------------------------------------------------------- without shading

/// The depth of each pixel's first sample, when nothing else is asked for.
void write_depth(const TileView& view, glm::ivec2 origin, Film& film) {
    const int width = std::min(tile_size, film.width - origin.x), height = std::min(tile_size, film.height - origin.y);
    Layer& depth = *film.find("depth");
    for (int y = 0; y < height; ++y)
        std::copy_n(&view.samples.depth[size_t(y) * tile_size], width,
                    depth.pixel(size_t(film.height - 1 - origin.y - y) * film.width + origin.x));
}

/// Which triangle each sample sees and its depth, when nothing else is asked for.
void write_visibility(const TileView& view, glm::ivec2 origin, int samples, Film& film) {
    const int width = std::min(tile_size, film.width - origin.x), height = std::min(tile_size, film.height - origin.y);
    for (int s = 0; s < samples; ++s)
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x) {
                const size_t at = (size_t(s) * tile_size + size_t(y)) * tile_size + size_t(x);
                const size_t pixel = size_t(film.height - 1 - origin.y - y) * film.width + size_t(origin.x + x);
                const uint32_t place = view.samples.triangle[at];
                film.layers[size_t(s)].data[pixel] = place == no_triangle ? 0 : float(view.triangles[place] + 1);
                film.layers[size_t(samples + s)].data[pixel] = view.samples.depth[at];
            }
}

/// The same for the reference: the rasterizer says which triangle, and the depth is worked out again.
void write_exact_depth(const Frame<double>& frame, TileView& view, Fragments& fragments, glm::ivec2 origin,
                       glm::ivec2 sample, const TileGrid& grid) {
    collect_fragments(view, 1, origin, grid, fragments);  // of the first sample's plane
    clear(frame.film, origin, glm::vec3(0));
    Layer& depth = *frame.film.find("depth");
    for_each_batch(frame, view, fragments, [&](const DrawnObject<double>& object, const Fragment* run, int count) {
        for (int i = 0; i < count; ++i)
            *depth.pixel(size_t(grid.height - 1 - origin.y - run[i].y) * grid.width + origin.x + run[i].x) =
                depth_of(object, view, run[i], origin, sample);
    });
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

// ---------------------------------------------------------------------------------------------- a tile

/// What a thread keeps from tile to tile.
template <class Real>
struct Worker {
    explicit Worker(const Frame<Real>& frame) : interpolator(frame) {}
    DrawStatistics statistics;
    TileView view;
    Fragments fragments;
    std::unique_ptr<FragmentBatch<Real>> batch = std::make_unique<FragmentBatch<Real>>();
    Interpolator<Real> interpolator;
};

/// A tile of the frame that something may be seen in.
template <class Real>
struct Tile {
    const Frame<Real>& frame;
    const Buffers& buffers;
    const TileGrid& grid;
    int number;
    glm::ivec2 origin;
    const std::vector<glm::ivec2>& samples;
};

template <class Real>
void draw_visibility(const Tile<Real>& tile, Worker<Real>& worker) {
    see<true>(tile.frame, tile.buffers, tile.grid, tile.number, tile.samples, worker.view);
    write_visibility(worker.view, tile.origin, int(tile.samples.size()), tile.frame.film);
}

void draw_depth(const Tile<float>& tile, Worker<float>& worker) {
    see<false>(tile.frame, tile.buffers, tile.grid, tile.number, tile.samples, worker.view);
    write_depth(worker.view, tile.origin, tile.frame.film);
}

void draw_depth(const Tile<double>& tile, Worker<double>& worker) {
    see<true>(tile.frame, tile.buffers, tile.grid, tile.number, tile.samples, worker.view);
    write_exact_depth(tile.frame, worker.view, worker.fragments, tile.origin, tile.samples[0], tile.grid);
}

/// Geometry layers show the surface at the pixel's centre, whatever the samples are.
template <class Real>
void draw_geometry(const Tile<Real>& tile, Worker<Real>& worker) {
    see<true>(tile.frame, tile.buffers, tile.grid, tile.number, sample_positions(1), worker.view);
    collect_fragments(worker.view, 1, tile.origin, tile.grid, worker.fragments);
    worker.interpolator.begin_tile(worker.view, tile.origin);
    for_each_batch(tile.frame, worker.view, worker.fragments,
                   [&](const DrawnObject<Real>& object, const Fragment* run, int count) {
                       worker.interpolator.interpolate(object, run, count, *worker.batch);
                       write_geometry(tile.frame, object, worker.view, tile.origin, run, *worker.batch);
                   });
}

template <class Real>
void draw_shaded(const Tile<Real>& tile, Worker<Real>& worker) {
    const Frame<Real>& frame = tile.frame;
    const int samples = int(tile.samples.size());
    see<true>(frame, tile.buffers, tile.grid, tile.number, tile.samples, worker.view);
    collect_fragments(worker.view, samples, tile.origin, tile.grid, worker.fragments);
    if (!worker.fragments.full) clear(frame.film, tile.origin, glm::vec3(frame.scene.film.background));
    worker.interpolator.begin_tile(worker.view, tile.origin);
    DrawStatistics& statistics = worker.statistics;
    FragmentBatch<Real>& batch = *worker.batch;
    for_each_batch(frame, worker.view, worker.fragments,
                   [&](const DrawnObject<Real>& object, const Fragment* run, int count) {
                       statistics.fallback_normals += worker.interpolator.interpolate(object, run, count, batch);
                       if (object.colour.empty()) statistics.lights_at_surface += shade(frame, object, batch);
                       if (!all_finite(count, batch.out[0], batch.out[1], batch.out[2])) {
                           worker.interpolator.surface(object, run, batch, true);
                           note_not_finite(frame, object, batch, statistics);
                       }
                       write_colours(frame, batch);
                       if (frame.features.geometry_layers && samples == 1)
                           write_geometry(frame, object, worker.view, tile.origin, run, batch);
                       statistics.fragments += count;
                   });
    if (frame.features.geometry_layers && samples > 1) draw_geometry(tile, worker);
}

template <class Real>
void draw_tile(const Tile<Real>& tile, Worker<Real>& worker) {
    const size_t tiles = size_t(tile.grid.across * tile.grid.down), number = size_t(tile.number);
    const bool anything =
        std::any_of(tile.buffers.stretches.begin(), tile.buffers.stretches.end(),
                    [&](const Stretch& s) { return !s.bins[number].empty() || !s.bins[tiles + number].empty(); });
    if (!anything)
        clear(tile.frame.film, tile.origin, glm::vec3(tile.frame.scene.film.background));
    else if (tile.frame.features.visibility)
        draw_visibility(tile, worker);
    else if (!tile.frame.plugin)
        draw_depth(tile, worker);
    else
        draw_shaded(tile, worker);
}

// ---------------------------------------------------------------------------------------------- the frame

template <class Real>
DrawStatistics draw_here(const Scene& scene, const Features& features, const FrameFacts& facts,
                         const std::vector<Mesh>& meshes, const plugin::Table<Real>* plugin, Film& film,
                         Workspace& workspace) {
    DrawStatistics statistics;
    const double start = now_ms();
    Frame<Real> frame{scene, features, plugin, film, {}, {}, glm::vec<3, Real>(scene.camera.eye), 0};
    if (plugin) {
        frame.layers_out = plugin->terms ? 12 : 3;
        for (const std::vector<double>& light : facts.lights) frame.lights.emplace_back(light.begin(), light.end());
    }
    uint32_t vertices = 0, triangles = 0;
    for (size_t i = 0; i < scene.objects.size(); ++i) {
        frame.objects.push_back(prepare_object(frame, scene.objects[i], meshes[i], facts, vertices, triangles));
        vertices += uint32_t(meshes[i].positions.size());
        triangles += uint32_t(meshes[i].triangle_count());
    }
    if (plugin)
        for (DrawnObject<Real>& object : frame.objects)
            if (object.object->interpolation == Interpolation::gouraud)
                shade_vertices(frame, object, statistics.lights_at_surface);
    const double objects_done = now_ms();

    if (!workspace.buffers) workspace.buffers = std::make_shared<Buffers>();
    Buffers& buffers = *static_cast<Buffers*>(workspace.buffers.get());
    const TileGrid grid(film.width, film.height);
    const std::vector<glm::ivec2>& samples = sample_positions(scene.film.samples);
    bin_scene(frame.objects, grid, samples.size() > 1 ? 128 : 0, buffers, statistics);
    const double bins_done = now_ms();

#pragma omp parallel
    {
        Worker<Real> worker(frame);
#pragma omp for schedule(dynamic)
        for (int number = 0; number < grid.across * grid.down; ++number)
            draw_tile(Tile<Real>{frame, buffers, grid, number, grid.origin(number), samples}, worker);
#pragma omp critical
        merge(statistics, worker.statistics);
    }
    statistics.vertex_ms = objects_done - start;
    statistics.bin_ms = bins_done - objects_done;
    statistics.tile_ms = now_ms() - bins_done;
    return statistics;
}

}  // namespace

#ifdef SHADELAB_LEVEL_MODULE
extern "C" __attribute__((visibility("default")))
const DrawTable shadelab_draw_table = {draw_here<float>, draw_here<double>};
#else
const DrawTable plain_draw_table = {draw_here<float>, draw_here<double>};
#endif

}  // namespace shadelab
