_teleop() {
    local line word files=
    local -a names said knobs told
    local -a before=("${(Q@)words[2,CURRENT-1]}") # here, for sh counts the parts of an array otherwise
    for line in ${(f)"$(emulate sh; _teleop_complete "$PREFIX" "${before[@]}")"}; do
        word=${line%%$'\t'*}
        case $line in
            ($'\t'*) files=$line ;;
            (*=$'\t'*) knobs+=("$word"); told+=("$word  ${line#*$'\t'}") ;;
            (*) names+=("$word"); said+=("$word  ${line#*$'\t'}") ;;
        esac
    done
    (( ! $#names )) || compadd -l -d said -a names
    (( ! $#knobs )) || compadd -l -S '' -d told -a knobs
    [[ -z $files ]] || compset -P '*[=,]'
    case $files in
        ($'\t'folders) _files -/ ;;
        ($'\t'files*) _files -g "${files##*$'\t'}" ;;
    esac
}
if [ "$funcstack[1]" = _teleop ]; then _teleop "$@"; else compdef _teleop teleop; fi
