#pragma once
// Triangle meshes with a unit normal at every vertex.

#include <shadelab/scene.hpp>

#include <glm/glm.hpp>

#include <cstdint>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

namespace shadelab {

struct Mesh {
    /// What was subtracted, in double, before rounding: positions are relative to it. 0 unless the file's coordinates lie so far
    /// from 0 that float32 would lose the shape; then the centre of the bounding box.
    glm::dvec3 origin{0};
    std::vector<glm::vec3> positions;  ///< object space less origin, float32: what both renderers start from
    std::vector<glm::vec3> normals;    ///< unit, object space, one per position
    std::vector<uint32_t> indices;     ///< three per triangle
    glm::vec3 low{-std::numeric_limits<float>::infinity()},
        high{std::numeric_limits<float>::infinity()};  ///< a box that holds the positions

    int dropped_triangles = 0;       ///< not finite or without area: counted, never drawn
    int cancelled_normals = 0;       ///< vertices whose face normals cancel; they got the face normals instead
    bool opposing_normals = false;   ///< some triangle's vertex normals can interpolate to zero (hazard of sharp edges)
    std::vector<std::string> notes;  ///< what the loader ignored or replaced, one line each

    size_t triangle_count() const { return indices.size() / 3; }
};

/// Loads a Wavefront OBJ: polygons are triangulated, negative indices resolved, groups merged, materials ignored with a note.
///
/// Normals::smooth: the average of the adjacent face normals weighted by the angle that each face spans at the vertex
/// (Thuermer & Wuethrich 1998). By angle and not by area, so that cutting a quad into triangles differently, or refining one
/// face, does not tilt the normal. Normals::flat: the face normal (three vertices of its own per triangle). Normals::file: the
/// file's; smooth ones, with a note, at corners whose normal is no direction, and at all corners where some name none. Where a
/// vertex's normals cancel, each face keeps its own. Vertices are one when they are one in the file: two that stand at the same
/// place are a seam, and smoothing groups are ignored with a note.
///
/// Throws InputError (`where` says who asked for the file, for the message when it is absent).
Mesh load_mesh(const std::filesystem::path& file, Normals mode, const std::string& where = "");

/// Whether an interpolated normal of this mesh, so transformed, can come near zero, and the renderers need the fallback to the
/// face normal. False only where it is certain.
bool normals_can_cancel(const Mesh& mesh, const glm::dmat4& to_world);

}  // namespace shadelab
