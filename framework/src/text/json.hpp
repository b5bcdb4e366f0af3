#pragma once
// JSON, for all that the framework writes in it: tables of toml++, which escapes texts and writes numbers so that they come
// back as they were. What JSON cannot say (NaN, infinity) becomes a text that Python's float() takes.

#include "text/toml_reader.hpp"

#include <glm/glm.hpp>

#include <sstream>
#include <string>
#include <vector>

namespace shadelab::json {

inline std::string text(const toml::table& table) {
    std::ostringstream out;
    out << toml::json_formatter(table) << "\n";
    return out.str();
}

/// In one line: line breaks inside of texts are escaped, all others are the formatter's.
inline std::string line(const toml::table& table) {
    std::string out = text(table);
    std::erase(out, '\n');
    return out;
}

template <class Number>
toml::array array(const Number* values, size_t count) {
    toml::array out;
    for (size_t i = 0; i < count; ++i) out.push_back(double(values[i]));
    return out;
}

template <class Number>
toml::array array(const std::vector<Number>& values) {
    return array(values.data(), values.size());
}

inline toml::array array(glm::dvec3 v) { return array(&v.x, 3); }

inline toml::array array(const std::vector<std::string>& texts) {
    toml::array out;
    for (const std::string& text : texts) out.push_back(text);
    return out;
}

/// Column by column.
template <class Matrix>
toml::array columns(const Matrix& m) {
    toml::array out;
    for (int c = 0; c < m.length(); ++c)
        for (int r = 0; r < m[c].length(); ++r) out.push_back(double(m[c][r]));
    return out;
}

}  // namespace shadelab::json
