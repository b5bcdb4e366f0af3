#pragma once
// The frame packet: everything an OpenGL client needs to draw a scene except the student's GLSL. Clients (the grader's, the
// viewer) upload and draw; nothing about scenes is known to them.

#include <shadelab/features.hpp>
#include <shadelab/manifest.hpp>
#include <shadelab/mesh.hpp>

#include <filesystem>

namespace shadelab {

/// Writes one file: the line "shadelab packet 1", the length of the header in bytes as a line, the header (JSON), then the
/// buffers (little-endian float32 and uint32) at the offsets that the header gives, counted from the first byte behind it.
///
/// The header: width and height (already multiplied by supersample), supersample, samples, background, terms, geometry and depth (bool: which layers; depth: that of each pixel's first sample, and nothing else), prelude, programs[] and geometry_programs[] (vertex, fragment:
/// main texts; student_in_vertex), draws[] (program, geometry_program, positions, normals (not with depth), indices: {offset, count}; uniforms: name
/// -> numbers, matrices by column), light_texels ({offset, count, width}; only where the mains read their lights from the RGBA32F texture shadelab_lights, as glue.hpp says), lines: the first line numbers of prelude and mains.
void write_packet(const Scene& scene, const Manifest& manifest, const Features& features,
                  const std::vector<Mesh>& meshes, int supersample, const std::filesystem::path& include_folder,
                  const std::filesystem::path& file);

}  // namespace shadelab
