#pragma once
// The frame packet: everything an OpenGL client needs to draw a scene except the student's GLSL. Clients (the grader's, the
// benchmark's, a viewer, a browser) upload, draw and read back; they know no scene, no layer, no light and no model.

#include <shadelab/features.hpp>
#include <shadelab/manifest.hpp>
#include <shadelab/mesh.hpp>

#include <filesystem>
#include <string>

namespace shadelab {

/// The file: the line "shadelab packet 2", the length of the header in bytes as a line, the header (JSON), then the buffers
/// (little-endian float32 and uint32) at the offsets that the header gives, counted from the first byte behind it.
///
/// The header:
///     width, height     of the targets, pixels: the film's times supersample
///     supersample       how many of these make a pixel of the film, in each direction
///     glsl              version ("330") and precision (statements that stand behind #version, or "")
///     sources           texts that several stages share, by name
///     programs[]        vertex, fragment: pieces in their order, each with `line`, the number of its first line, and one of `text`,
///                       `source` (a name) and `student` (true: the student's file stands here). A stage is #version, precision and
///                       each piece behind a #line of its own, so that a line in a driver's message tells the piece
///     textures[]        name (of the sampler), offset, width, height: RGBA float32, read with texelFetch; bound to units in order
///     uniforms          what all objects share: name -> numbers, matrices by column. A program need not have them all
///     objects[]         attributes: name -> offset, count (of vertices), components;  indices: offset, count;  uniforms;
///                       to_world: 16 numbers by column, in double
///     camera            eye, world_to_clip (by column, in double): shadelab_to_clip is world_to_clip to_world; who moves the camera
///                       computes it anew
///     passes[]          name;  samples (1, or coverage and depth samples of a pixel);
///                       targets[]: layer (for people) and clear (four numbers): RGBA float32;  depth is cleared to 1, less passes;
///                       draws[]: object, program
///     film[]            the image's layers in their order: layer, channels, pass, target (-1: the pass's depth, of each pixel's first
///                       sample), first (the target's first component that is of it), reduce: "mean" (of the supersample^2 pixels, in
///                       double) or "centre" (the pixel nearest the centre)
struct Packet {
    std::string header;   ///< JSON
    std::string buffers;  ///< what the offsets point into
};

/// Throws InputError for a scene that OpenGL clients cannot draw.
Packet make_packet(const Scene& scene, const Manifest& manifest, const Features& features,
                   const std::vector<Mesh>& meshes, int supersample, const std::filesystem::path& framework);
void write_packet(const Packet& packet, const std::filesystem::path& file);

}  // namespace shadelab
