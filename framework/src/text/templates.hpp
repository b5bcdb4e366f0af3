#pragma once
// Text files with gaps: the code that stands round a student's, as files that one can read (framework/glsl, framework/glue).

#include <filesystem>
#include <map>
#include <string>

namespace shadelab {

/// The file's text with "@name@" replaced by words["name"]. Throws InputError for a file that cannot be read, std::logic_error
/// for a gap that has no word.
std::string filled(const std::filesystem::path& file, const std::map<std::string, std::string>& words = {});

/// The whole file.
std::string read_text(const std::filesystem::path& file);

}  // namespace shadelab
